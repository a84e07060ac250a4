"""Small scenes written by tests, and cases of scenes."""

from collections.abc import Callable
from pathlib import Path

from drivers.chain.case import Case
from validation.accuracy.plan import planned_case

BASE = """
[chain]
count = {count}
material = "ptfe"
diameter = "4.76 mm"
mass = "0.1226 g"
{chain}
{striker}
{wall}
[run]
duration = "{duration}"
sample_interval = "1 us"
time_step = "{step}"
"""
STRIKER = '[striker]\nmaterial = "ptfe"\ndiameter = "4.76 mm"\nspeed = "1 m/s"\n'
WALL = '[wall]\nmaterial = "brass"\n'

SPEEDS = '[[axis]]\nkey = "striker.speed"\nfrom = "0.5 m/s"\nto = "2 m/s"\ncount = {}\n'

EnginesWriter = Callable[[str], Path]
SceneWriter = Callable[..., Path]
StudyWriter = Callable[..., Path]
StandIn = Callable[[str, str], None]


def case_of(scene: str | Path, *settings: str) -> Case:
    """Planned case of a scene with settings."""
    return planned_case(scene, *settings)
