"""LAMMPS and its descendants: commands, error messages, dumps, stiffness by pairs of types, axial forces."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base.decks import Deck
from drivers.base.processes import line_of
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain
from drivers.chain.trace import Trace
from drivers.engines import IN_HEIGHTS, Engine, last_line
from drivers.engines._raw_output import contact_forces, read_dump, read_partial_dump

DUMP = "chain.bin"
FLAT_PREFIX = "flat "  # before the material's name: the type of a striker's flat face
# lets Open MPI run as root, and on fewer cores than processes
OPEN_MPI = (
    "OMPI_ALLOW_RUN_AS_ROOT=1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1",
    "OMPI_MCA_rmaps_base_oversubscribe=1",
)
MAX_BODIES_IN_PAIRS = 200  # with fewer bodies, checking all pairs is faster than bins of the whole space


def member(
    program: str,
    introduction: str,
    columns: Callable[[Case], tuple[str, ...]],
    trace: Callable[[Case, dict[str, Array]], Trace],
    **own: Any,
) -> Engine:
    """Build the engine of LAMMPS or a descendant.

    Args:
        program: name of the program.
        introduction: regular expression that matches the line with the version.
        columns: function that names the columns of the dump.
        trace: function that turns the columns into a trace.
        own: further fields of ``Engine``.
    """

    def read(case: Case, folder: Path) -> Trace:
        """Read the binary dump as a trace; RunError if frames or beads are missing or the file is damaged."""
        return trace(case, read_dump(case, folder / DUMP, columns(case)))

    def partial_trace(case: Case, folder: Path) -> Trace | None:
        """Read the samples before a body was lost or the run ended."""
        found = read_partial_dump(case, folder / DUMP, columns(case))
        return trace(case, found) if found else None

    return Engine(
        program=program,
        version=lambda command: line_of(command, "-help", introduction),
        scheme=IN_HEIGHTS,
        server=Deck({}, ("stdbuf", "-oL", program, "-log", "none"), raw=()),  # reads commands from stdin
        request=request_by_include,
        read=read,
        partial_trace=partial_trace,
        failure_reason=failure_reason,
        loss_message="Lost atoms",
        loop_pattern=r"^Loop time of ([0-9.e+-]*[0-9]) on",
        on_two_cores=on_two_cores,
        **own,
    )


def command_of(program: str) -> tuple[str, ...]:
    """Command of a deck; ``-oL`` keeps the last lines of a process that aborts."""
    return ("stdbuf", "-oL", program, "-in", "chain.in", "-log", "none")


def request_by_include(folder: str, word: str) -> str:
    """Commands that run ``chain.in`` of a folder, clear all settings, and print the word."""
    deck = f"shell cd {folder}\ninclude chain.in\nclear\nshell cd ..\n" if folder else ""
    return f'{deck}print "{word}"\n'


def failure_reason(stdout: str, stderr: str) -> str:
    """Last line that begins with ERROR; else the last line that is not from hwloc."""
    errors = [line.strip() for line in f"{stderr}\n{stdout}".splitlines() if line.startswith("ERROR")]
    return errors[-1] if errors else last_line(stderr, stdout, ("[hwloc/",))


def on_two_cores(deck: Deck) -> Deck:
    """Deck with the lower and the upper half of the chain on one core each."""
    files = {name: text.replace("boundary ", "processors      1 1 2\nboundary ") for name, text in deck.files.items()}
    command = ("env", *OPEN_MPI, "mpirun", "-np", "2", *deck.command)
    return replace(deck, files=files, command=command)


def contact_kn(chain: Chain, radius_m: Array) -> Array:
    """Stiffness kn of each contact in ``F = kn sqrt(R*) overlap^(3/2)``, with radii of atoms. Shape (bodies,)."""
    reduced = np.append(radius_m[0], 1 / (1 / radius_m[1:] + 1 / radius_m[:-1]))
    return np.asarray(chain.stiffness / np.sqrt(reduced))


def axial_forces(chain: Chain, found: dict[str, Array], wall_force: str, bore_N: Array | None = None) -> Array:
    """Contact forces from the columns ``fz``, the total force on a bead, and ``wall_force`` of a dump.

    They follow from the wall's force F_1 upwards: ``F_{j+1} = F_j - fz_j + load_j + bore_j``.
    """
    on_bodies = found["fz"] - chain.load_N
    lowest = found[wall_force][:, 0] if chain.wall else np.zeros(len(on_bodies))
    return contact_forces(lowest, on_bodies if bore_N is None else on_bodies - bore_N)
