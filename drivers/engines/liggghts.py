"""LIGGGHTS: renders its deck, reads its dump."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.base.decks import Deck
from drivers.base.decks import render as render_template
from drivers.base.errors import InputProblem, RunError
from drivers.base.processes import find_program, version_in_words
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, energy_put_in, free_fall, sphere_for_face
from drivers.chain.contact_law import damping_ratio_with_attraction, restitution, restitution_with_attraction
from drivers.chain.elements import SIDEWAYS, STRAIGHT
from drivers.chain.trace import Trace, make_trace
from drivers.engines import IN_HEIGHTS, TOTAL, Engine, Style, last_line
from drivers.engines import _liggghts_tube as sideways
from drivers.engines._materials import named_material
from drivers.engines._sums import contact_forces

COMMAND = ("stdbuf", "-oL", "liggghts", "-in", "chain.in", "-log", "none")
HARD_PA, SOFT_PA = 1e9, 5e6  # LIGGGHTS refuses moduli beyond these unless told
FEW = 200  # bodies up to which all pairs are searched for neighbours: bins of the whole space would take longer
MESH = "tube.stl"
MOST_TRIANGLES = 100_000  # of a mesh: some 20 MB of text
MOST_BINS = 100_000_000  # of its neighbour search: each takes 16 bytes, and beyond 2^31 it gives up
LEAST_COEFFICIENT = 0.05  # of restitution, which it takes only from above here
FLAT = "flat "  # before the material's name: the type of a striker's flat face


@dataclass(frozen=True)
class Atom:
    """A line of the data file."""

    type: int
    diameter: float
    density: float
    x: float
    y: float
    height: float
    x_velocity: float
    y_velocity: float
    velocity: float


@dataclass(frozen=True)
class Box:
    """The space that LIGGGHTS searches for neighbours; lengths in m."""

    half_width: float
    low: float
    high: float
    skin: float


def refusal(case: Case) -> InputProblem | None:
    """Too much damping, too fine a mesh, or a box too high for its neighbour search, whose bins are half a cutoff."""
    chain, radius = case.chain, _radii(case)
    if restitution_with_attraction(chain.damping_ratio) <= LEAST_COEFFICIENT:
        most = damping_ratio_with_attraction(LEAST_COEFFICIENT)
        if case.scene.contact.restitution is None:
            return "contact.damping_ratio", f"{chain.damping_ratio:g}", f"below {most:.4g}"
        return "contact.restitution", f"{case.scene.contact.restitution:g}", f"above {restitution(most):.4g}"
    bore = chain.bore
    if bore is not None and bore.sides and bore.triangles > MOST_TRIANGLES:
        return "tube.sides", f"{bore.sides}, {bore.triangles:.2g} triangles", f"at most {MOST_TRIANGLES:,}: fewer sides"
    if not _binned(chain):
        return None
    box = _box(case, radius, chain.height_m)
    bin_m = radius.max() + box.skin / 2
    height = box.high - box.low
    bins = height / bin_m * (2 * box.half_width / bin_m) ** 2
    if bins <= MOST_BINS:
        return None
    found = f"a space {height:.3g} m high for beads to fly in, {bins:.2g} bins"
    return "run.duration", found, f"at most {MOST_BINS:.0e} bins: less speed, smaller gaps or a shorter run"


def _binned(chain: Chain) -> bool:
    """Whether neighbours are searched in bins: where there are many, and where a mesh asks for it."""
    bore = chain.bore
    return chain.bodies > FEW or (bore is not None and bore.sides is not None)


def _radii(case: Case) -> Array:
    """Radii of the atoms; that of a flat face is as large as the bead below it, or a damped one's of ``face``."""
    chain = case.chain
    if not np.isinf(chain.radius_m[-1]):
        return chain.radius_m
    face = chain.radius_m[-2] if _by_springs(case) else sphere_for_face(case.scene, case.chain)[0]
    return np.where(np.isinf(chain.radius_m), face, chain.radius_m)


def _by_springs(case: Case) -> bool:
    """Whether contacts get their stiffness by pairs of types: all that an elastic, straight, flat strike needs."""
    chain = case.chain
    return bool(np.isinf(chain.radius_m[-1])) and not chain.damping_ratio and chain.lateral is None


def _above_face(case: Case) -> Array:
    """By how much atoms are higher than their bodies: a face's is a sphere that touches the bead below off its axis."""
    chain, radius = case.chain, _radii(case)
    above = np.zeros(chain.bodies)
    if np.isinf(chain.radius_m[-1]):
        apart = radius[-1] + radius[-2]
        off = float(np.hypot(*chain.lateral.offset_m[-2])) if chain.lateral else 0.0
        above[-1] = math.sqrt(apart**2 - off**2) - radius[-2] if off else radius[-1]
        if chain.damping_ratio:  # just touching, which rounding must not make an overlap of: see Chain.height_m
            above[-1] += 4 * np.spacing(apart)
    return above


def _box(case: Case, radius: Array, height: Array) -> Box:
    chain, duration = case.chain, float(case.sample_times_s[-1])
    fastest = math.sqrt(2 * energy_put_in(chain, duration) / chain.mass_kg.min())
    if chain.wall is None:
        fastest += (
            abs(float(chain.mass_kg @ chain.velocity_m_s / chain.mass_kg.sum())) + abs(free_fall(chain)) * duration
        )
    reach = 1.1 * fastest * duration + 4 * radius.max()  # nothing gets further: what leaves the box has blown up
    if chain.lateral is not None and chain.lateral.bore is not None:
        reach = max(reach, chain.lateral.bore.high_m - float(height.min()))  # a mesh has to be inside
    width = float(f"{4 * radius.max():.1g}")
    if chain.lateral is not None and (chain.lateral.bore is None or len(chain.lateral.bore.guided) < chain.bodies):
        width = max(width, float(f"{reach:.2g}"))  # nothing holds it on the axis
    digits = 2 - math.floor(math.log10(reach))
    low, high = round(float(height.min() - reach), digits), round(float(height.max() + reach), digits)
    return Box(width, low, high, skin=float(f"{0.2 * radius.min():.1g}"))


def render(case: Case) -> Deck:
    """``chain.in`` and ``chain.data``; atoms are numbered as the bodies, from the wall up."""
    scene, chain, radius = case.scene, case.chain, _radii(case)
    flat = bool(np.isinf(chain.radius_m[-1]))
    labels = sideways.bead_labels(case)
    if flat:
        labels[-1] = FLAT + labels[-1]
    material_of = dict(zip(labels, chain.materials, strict=True))
    unique = list(material_of)
    types = [named_material(scene, material, label) for label, material in material_of.items()]
    wall_type = 0
    if chain.wall and case.models("wall"):
        if chain.wall not in unique:
            types.append(named_material(scene, chain.wall))
            unique.append(chain.wall)
        wall_type = unique.index(chain.wall) + 1
    lateral = chain.lateral
    if lateral is not None and lateral.bore is not None:
        assert scene.tube is not None
        types.append(named_material(scene, scene.tube.material, sideways.TUBE))
        unique.append(sideways.TUBE)
    springs = _by_springs(case)
    if flat and not springs:
        face = unique.index(labels[-1])
        types[face] = replace(types[face], youngs_modulus=sphere_for_face(scene, chain)[1])
    moduli = [kind.youngs_modulus for kind in types]
    volume = 4 / 3 * math.pi * radius**3
    height = chain.height_m + _above_face(case)
    box = _box(case, radius, height)
    offset, across = (lateral.offset_m, lateral.velocity_m_s) if lateral else (np.zeros((chain.bodies, 2)),) * 2
    atoms = [
        Atom(
            type=unique.index(labels[i]) + 1,
            diameter=2 * radius[i],
            density=chain.mass_kg[i] / volume[i],
            x=offset[i, 0],
            y=offset[i, 1],
            height=height[i],
            x_velocity=across[i, 0],
            y_velocity=across[i, 1],
            velocity=chain.velocity_m_s[i],
        )
        for i in range(chain.bodies)
    ]
    values = {
        "summary": case.summary,
        "types": types,
        "stiffnesses": _pair_stiffnesses(chain, radius, labels, unique, wall_type) if springs else [],
        "model": "hertz/stiffness" if springs else "hertz",
        "damping_ratio": chain.damping_ratio,
        "coefficient": restitution_with_attraction(chain.damping_ratio),
        "face_radius": radius[-1] if flat and not springs else None,
        "hard": not springs and max(moduli) > HARD_PA,
        "soft": not springs and min(moduli) < SOFT_PA,
        "tube": sideways.tube_of(case, lateral, labels, unique, MESH) if lateral else None,
        "friction": sideways.friction_of(lateral, unique) if lateral else [],
        "slips_between": lateral is not None and lateral.friction > 0,
        "rotation": case.models("rotation"),
        "guided_face": chain.bodies if flat and lateral else None,
        "columns": sideways.columns(case),
        "skin": box.skin,
        "binned": _binned(chain),
        "triangles": lateral.bore.triangles if lateral and lateral.bore else 0,
        "wall_type": wall_type,
        "wall_height": chain.wall_height_m,
        "gravity": chain.gravity_m_s2 if case.models("gravity") else None,
        "precompression": chain.precompression_N if case.models("precompression") else None,
        "top": chain.beads,
        "time_step": scene.time_step_s,
        "every": scene.steps_per_sample,
        "steps": scene.steps,
        "thermo": max(1, scene.steps // 10),
        "atoms": atoms,
        "half_width": box.half_width,
        "z_low": box.low,
        "z_high": box.high,
    }
    files = {name: render_template(f"liggghts/{name}.j2", **values) for name in ("chain.in", "chain.data")}
    if lateral is not None and lateral.bore is not None and lateral.bore.sides:
        files[MESH] = lateral.bore.mesh
    return Deck(files, COMMAND, raw=("chain.bin",))


def _pair_stiffnesses(chain: Chain, radius: Array, labels: list[str], unique: list[str], wall_type: int) -> list[float]:
    """Kn of each pair of types in F = kn sqrt(R*) overlap^(3/2), row by row; pairs that never meet get 1."""
    kn = np.ones((len(unique), len(unique)))
    for j in range(chain.bodies):
        if j == 0 and not wall_type:
            continue
        below = wall_type - 1 if j == 0 else unique.index(labels[j - 1])
        here = unique.index(labels[j])
        reduced = radius[j] if j == 0 else 1 / (1 / radius[j - 1] + 1 / radius[j])
        kn[below, here] = kn[here, below] = chain.stiffness[j] / math.sqrt(reduced)
    return [float(value) for value in kn.ravel()]


def request(folder: str, word: str) -> str:
    """Runs the deck of a folder, forgets it, and says the word; without a folder, just says it."""
    deck = f"shell cd {folder}\ninclude chain.in\nclear\nshell cd ..\n" if folder else ""
    return f'{deck}print "{word}"\n'


def read(case: Case, folder: Path) -> Trace:
    """The binary dump as a trace.

    ``fz`` is the total force on a bead, so with the wall's force F_1 known, contact forces follow upwards:
    ``F_{j+1} = F_j - fz_j + load_j``.

    Raises:
        RunError: frames or beads are missing, or the file is torn.
    """
    chain, samples = case.chain, case.scene.samples
    frames = _frames(case, folder)
    good = _whole(case, frames)
    if not good.all():
        first = int(np.argmin(good))
        atoms, count = frames["atoms"][first], frames["count"][first]
        if 0 <= atoms < chain.bodies and count == atoms * len(sideways.columns(case)):
            at = case.sample_times_s[min(first, samples - 1)]
            raise RunError(f"unstable at t = {at:g} s: {atoms} bodies instead of {chain.bodies}, one was lost")
        raise RunError(f"output is torn in sample {first + 1}")
    if len(frames) != samples:
        raise RunError(f"output ends in sample {min(len(frames) + 1, samples)} of {samples}")
    if not np.array_equal(frames["step"], case.sample_steps):
        raise RunError("output has other time steps than the samples")
    if (frames["values"][:, :, 0] != np.arange(1, chain.bodies + 1)).any():
        raise RunError("output has its beads in another order")
    return _trace(case, frames)


def partial_trace(case: Case, folder: Path) -> Trace | None:
    """The samples before a body was lost, or the run ended."""
    try:
        frames = _frames(case, folder)
    except RunError:
        return None
    whole = np.logical_and.accumulate(_whole(case, frames))[: case.scene.samples]
    return _trace(case, frames[: whole.sum()]) if whole.any() else None


def _trace(case: Case, frames: NDArray[np.void]) -> Trace:
    chain = case.chain
    dumped = {name: frames["values"][:, :, place] for place, name in enumerate(sideways.columns(case))}
    height = dumped["z"]
    if np.isinf(chain.radius_m[-1]):
        height = height - _above_face(case)
    if chain.lateral is not None:
        return sideways.sideways_trace(case, dumped, height)
    lowest = dumped["f_force_wall[3]"][:, 0] if chain.wall else np.zeros(len(frames))
    force = contact_forces(lowest, dumped["fz"] - chain.load_N)
    return make_trace(chain, case.sample_times_s[: len(frames)], force, height, dumped["vz"])


def _whole(case: Case, frames: NDArray[np.void]) -> NDArray[np.bool_]:
    """Which frames hold all bodies."""
    bodies = case.chain.bodies
    return np.asarray((frames["atoms"] == bodies) & (frames["count"] == bodies * len(sideways.columns(case))))


def _frames(case: Case, folder: Path) -> NDArray[np.void]:
    """The whole frames of a binary dump, as LIGGGHTS 3.8 lays them out on one process.

    Raises:
        RunError: there is no dump.
    """
    frame = np.dtype(
        [
            ("step", "i8"),
            ("atoms", "i8"),
            ("triclinic", "i4"),
            ("boundary", "i4", 6),
            ("box", "f8", 6),
            ("columns", "i4"),
            ("processes", "i4"),
            ("count", "i4"),
            ("values", "f8", (case.chain.bodies, len(sideways.columns(case)))),
        ]
    )
    try:
        raw = (folder / "chain.bin").read_bytes()
    except OSError as error:
        raise RunError(f"no output: {error.strerror}") from error
    return np.frombuffer(raw, frame, count=len(raw) // frame.itemsize)


def failure_reason(stdout: str, stderr: str) -> str:
    """The line that begins with ERROR; else the last one that is not of the library which looks for processors."""
    errors = [line.strip() for line in f"{stderr}\n{stdout}".splitlines() if line.startswith("ERROR")]
    return errors[-1] if errors else last_line(stderr, stdout, ("[hwloc/",))


def on_two_cores(deck: Deck) -> Deck:
    """The deck with the two halves of the chain, one above the other, on a core each."""
    files = {name: text.replace("boundary ", "processors      1 1 2\nboundary ") for name, text in deck.files.items()}
    command = ("mpirun", "--allow-run-as-root", "--oversubscribe", "-np", "2", *deck.command)
    return replace(deck, files=files, command=command)


ENGINE = Engine(
    how_to_get="Debian's package liggghts",
    find=lambda: find_program("liggghts"),
    version=lambda executable: version_in_words(executable, "-help", r"LIGGGHTS \(Version ([^,)]+)"),
    scheme=IN_HEIGHTS,
    shear=TOTAL,
    models=STRAIGHT | SIDEWAYS,
    refusal=refusal,
    render=render,
    server=Deck({}, ("stdbuf", "-oL", "liggghts", "-log", "none"), raw=()),  # takes its commands from stdin
    request=request,
    read=read,
    partial_trace=partial_trace,
    failure_reason=failure_reason,
    loss_message="Lost atoms",
    loop_pattern=r"^Loop time of ([0-9.e+-]*[0-9]) on",
    on_two_cores=on_two_cores,
    style=Style("#0072b2", marker="s", size=4.5),
)
