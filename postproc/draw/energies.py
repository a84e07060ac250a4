"""Energy of each body and contact of a straight chain against time, above its state at time 0, and its figure.

With the displacements u of the bodies since time 0, the overlaps d and their changes ``x_j = u_{j-1} - u_j``, the
equations of motion are ``m v_j' = G_j - G_{j+1} + r_j`` with ``G_j = F_j - F_j(0)``, the contact force beyond the
elastic force at time 0, and the net load r at time 0, which is zero in equilibrium. So the energies are

* kinetic energy of body j, ``m v_j^2 / 2``, and the potential of its net load, ``-r_j u_j``;
* elastic energy of contact j, ``E(d_j + x_j) - E(d_j) - F_j(0) x_j``: Hertz's energy less the work of the static force,
  so that a strong precompression does not hide a weak wave;
* energy dissipated in contact j, the integral of ``(F_j - k d^(3/2)) d'``;
* energy that body j passes to the contact below it, the integral of ``-G_j v_j``.

Both integrals are those of the scheme of the run, integrated with the motion: samples are too coarse where contacts
open and close.

Kinetic, potential and elastic energies add up to the total energy of the trace, up to its value of the potential at
time 0. The energy of a body includes half of the elastic energy of the contact above it and half of that below it; a
contact at the wall belongs to body 1.
"""

import re
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.schemes import exact_motion, verlet_motion
from drivers.chain.trace import Trace, overlaps, table_of
from drivers.engines import EXACT, load_engine
from drivers.run.run_folder import COMPRESSED, EndedRun
from postproc.draw.plot import AVERAGE, DAMPED, FIRST, GREYS, MICRO, SECOND, Product, draw_cells, pyplot
from postproc.read.motion import case_of_run
from validation.reference.hertz_chain import hertz_energy_beyond_tangent

SIZE_IN = (6.4, 4.6)
BODIES = "body_{}_energy_J", "body", "energy"
LOOKS = (FIRST, SECOND, {"color": GREYS[1], "lw": 0.8}, DAMPED)  # of the sums, in their order
RANGE_DASHES = ("-", "--", ":", "-.")
LEFT_SHARE = 0.01  # of the largest energy of a range: with less the energy has left


class Energies(NamedTuple):
    """Energies in J of shape (samples, bodies); contact j lies under body j.

    Attributes:
        time_s: sample times. Shape (samples,).
        body_kinetic_J: kinetic energy of each body.
        body_load_J: potential of the load on each body that is not balanced at time 0.
        contact_elastic_J: elastic energy of each contact since time 0, less the work of the static force.
        contact_dissipated_J: energy dissipated in each contact since time 0; zero for elastic contacts.
        body_passed_J: energy that each body has passed to the contact below it since time 0.
    """

    time_s: Array
    body_kinetic_J: Array
    body_load_J: Array
    contact_elastic_J: Array
    contact_dissipated_J: Array
    body_passed_J: Array

    @property
    def body_J(self) -> Array:
        """Energy of each body, with half of the elastic energy of its contacts, and all of that at the wall."""
        above = np.pad(self.contact_elastic_J[:, 1:] / 2, ((0, 0), (0, 1)))
        below = np.hstack([self.contact_elastic_J[:, :1], self.contact_elastic_J[:, 1:] / 2])
        return np.asarray(self.body_kinetic_J + self.body_load_J + below + above)

    @property
    def sums_J(self) -> dict[str, Array]:
        """Sums of all bodies and contacts by name, each of shape (samples,)."""
        return {
            "kinetic": self.body_kinetic_J.sum(axis=1),
            "elastic": self.contact_elastic_J.sum(axis=1),
            "potential of the net load": self.body_load_J.sum(axis=1),
            "dissipated": self.contact_dissipated_J.sum(axis=1),
        }


def run_energies(run: EndedRun) -> Energies:
    """Energies of a run.

    Raises:
        InputError: the beads move sideways; the run recorded no positions, or a file is missing or damaged.
    """
    case = case_of_run(run)
    if not case.chain.straight:
        allowed = "a straight chain; forces.parquet has the total energies of all runs"
        raise InputError(paths.shown(run.folder), "", "a scene whose beads move sideways", allowed)
    return energies_of(case, run.record.engine, run.state)


def energies_of(case: Case, engine: str, trace: Trace) -> Energies:
    """Energies of a straight chain from a trace with heights and velocities at the samples of the case.

    Raises:
        ArithmeticError: the exact motion, for a run of ``reference``, cannot be integrated.
    """
    chain, height_m, times_s = case.chain, trace.place_m[..., 2], case.sample_times_s
    if load_engine(engine).scheme == EXACT:
        motion: Any = exact_motion(case, case.reference_tolerance, times_s, energies=True)
    else:
        motion = verlet_motion(case, energies=True)
    overlap, static_N = overlaps(chain, height_m), chain.elastic_N
    net_N = static_N - np.append(static_N[1:], 0.0) + chain.load_N
    return Energies(
        time_s=trace.time_s,
        body_kinetic_J=0.5 * chain.mass_kg * trace.velocity_xyz_m_s[..., 2] ** 2,
        body_load_J=-net_N * (height_m - chain.height_m),
        contact_elastic_J=hertz_energy_beyond_tangent(chain.stiffness, chain.overlap_m, overlap - chain.overlap_m),
        contact_dissipated_J=motion.dissipated_J,
        body_passed_J=motion.passed_J,
    )


def range_energy_J(energies: Energies, lowest: int, highest: int) -> Array:
    """Energy of the bodies from ``lowest`` to ``highest``, counted from the wall, both included. Shape (samples,).

    Raises:
        InputError: the chain has no such bodies.
    """
    bodies = energies.body_kinetic_J.shape[1]
    if not 1 <= lowest <= highest <= bodies:
        raise InputError("--beads", "", f"{lowest}-{highest}", f"a range from 1 to {bodies}, such as 1-{bodies}")
    return np.asarray(energies.body_J[:, lowest - 1 : highest].sum(axis=1))


def range_numbers(energies: Energies, lowest: int, highest: int) -> dict[str, float]:
    """Numbers of a range of bodies by name, with the unit at the end.

    These are the largest energy and its time; the share of the energy of all bodies at the end; the first time, after
    half of the largest energy has been reached, at which ``LEFT_SHARE`` of it is left, NaN if it stays until the end;
    and the largest energy that the lowest body has passed downwards.
    """
    energy = range_energy_J(energies, lowest, highest)
    top, all_J = int(np.argmax(energy)), float(energies.body_J[-1].sum())
    entered = int(np.argmax(energy >= energy[top] / 2))
    left = energy[entered:] <= LEFT_SHARE * energy[top]
    return {
        "largest_J": float(energy[top]),
        "largest_s": float(energies.time_s[top]),
        "share_at_end": float(energy[-1]) / all_J if all_J else np.nan,
        "left_s": float(energies.time_s[entered + int(np.argmax(left))]) if left.any() else np.nan,
        "passed_J": float(energies.body_passed_J[:, lowest - 1].max()),
    }


def draw_energies(energies: Energies, ranges: Sequence[tuple[int, int]], title: str) -> Product:
    """Energy of each body against time, and below it the sums of all bodies and contacts, and of ranges of bodies.

    The table holds the largest energy of a body in each drawn cell.
    """
    from matplotlib.ticker import EngFormatter

    joules, time_us = EngFormatter("J"), energies.time_s * MICRO
    figure, axes = pyplot().subplots(2, 1, figsize=SIZE_IN, sharex=True, layout="constrained")
    table = draw_cells(axes[0], title, energies.time_s, energies.body_J, BODIES, joules)
    for (label, values), look in zip(energies.sums_J.items(), LOOKS, strict=True):
        if values.any():
            axes[1].plot(time_us, values, label=label, **look)
    for (lowest, highest), dashes in zip(ranges, cycle(RANGE_DASHES), strict=False):
        look = AVERAGE | {"ls": dashes, "label": f"bodies {lowest} to {highest}"}
        axes[1].plot(time_us, range_energy_J(energies, lowest, highest), **look)
    axes[1].yaxis.set_major_formatter(joules)
    axes[1].set(xlim=(0, time_us[-1]), xlabel="time since impact (µs)", ylabel="energy")
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return Product(figure, table)


def write_energies(energies: Energies, path: Path, about: Mapping[str, str]) -> None:
    """Write the energies of all bodies and contacts at all samples as a Parquet file, whole or not at all.

    Args:
        energies: Energies of a run.
        path: File to be written.
        about: Metadata of the file (``RunRecord.about``).
    """
    from pyarrow.parquet import write_table

    columns = {re.sub("^(body|contact)", r"\1_{}", name): values for name, values in energies._asdict().items()}
    with whole_file(path) as draft:
        write_table(table_of(columns, about), draft, **COMPRESSED)
