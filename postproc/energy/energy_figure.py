"""Figure and tables of the energies of a run: each body against time, and sums of the chain and of ranges."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from drivers.base.files import whole_file
from drivers.chain.trace import table_of
from drivers.run.run_folder import COMPRESSED
from postproc.draw.product import Product, Quantity, draw_cells
from postproc.draw.style import AVERAGE, DAMPED, FIRST, GREYS, MICRO, SECOND, pyplot
from postproc.energy.energies import Energies, range_energy_J

SIZE_IN = (6.4, 4.6)
BODY = "body_{}_energy_J"
LOOKS = (FIRST, SECOND, {"color": GREYS[1], "lw": 0.8}, DAMPED)  # of the sums, in their order
RANGE_DASHES = ("-", "--", ":", "-.")


def draw_energies(energies: Energies, ranges: Sequence[tuple[int, int]], title: str) -> Product:
    """Energy of each body against time, and below it the sums of all bodies and contacts, and of ranges of bodies.

    The table holds the largest energy of a body in each drawn cell.
    """
    from matplotlib.ticker import EngFormatter

    joules, time_us = EngFormatter("J"), energies.time_s * MICRO
    figure, axes = pyplot().subplots(2, 1, figsize=SIZE_IN, sharex=True, layout="constrained")
    table = draw_cells(axes[0], title, energies.time_s, energies.body_J, Quantity(BODY, "body", "energy", joules))
    for (label, values), look in zip(energies.sums_J.items(), LOOKS, strict=True):
        if values.any():
            axes[1].plot(time_us, values, label=label, **look)
    for place, (lowest, highest) in enumerate(ranges):
        look = AVERAGE | {"ls": RANGE_DASHES[place % len(RANGE_DASHES)]}
        label = f"bodies {lowest} to {highest}"
        axes[1].plot(time_us, range_energy_J(energies, lowest, highest), label=label, **look)
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

    columns = {
        "time_s": energies.time_s,
        "body_{}_kinetic_J": energies.kinetic_J,
        "body_{}_load_J": energies.load_J,
        "body_{}_passed_J": energies.passed_J,
        "contact_{}_elastic_J": energies.elastic_J,
        "contact_{}_dissipated_J": energies.dissipated_J,
    }
    with whole_file(path) as draft:
        write_table(table_of(columns, about), draft, **COMPRESSED)
