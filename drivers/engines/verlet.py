"""``verlet``: velocity Verlet at the scene's time step, the scheme of all codes.

In three dimensions its friction stores the shear displacement, as in LIGGGHTS. Without slip this is Mindlin's force at
the present contact radius; YADE stores the shear force instead.
"""

from drivers.chain.case import SIDEWAYS, STRAIGHT
from drivers.engines import IN_OVERLAPS, _in_repo

ENGINE = _in_repo.in_repository_engine(
    "verlet",
    lambda case: {"time_step_s": case.scene.time_step_s, "steps_per_sample": case.scene.steps_per_sample},
    scheme=IN_OVERLAPS,
    models=STRAIGHT | SIDEWAYS,
    style={"color": "#009e73", "lw": 1.1, "ls": (0, (1, 2))},
)
