"""Table 1 computed: speed and width of solitary waves of five amplitudes, by the reference and by each code.

The amplitude is that of the sensors' averages above their static value, of a chain without lighter sensor beads,
E = 1.46 GPa, gravity on, the striker counted among the 21 beads: the reading that reproduces the printed numbers.
"""

from pathlib import Path

import pandas as pd

from postproc.paper.quoted import quoted
from postproc.paper.strikes import sensor_amplitude, sensor_pair, speed_between_sensors, strike_for, strikes_by_codes
from postproc.read.residual import REFERENCE

COLUMNS = ("speed_m_s", "width_0.2pct_diameters", "width_4pct_diameters")
STRIKER = "_striker_m_s"


def solve_table1(runs: Path) -> pd.DataFrame:
    """A row per amplitude: the paper's columns, then the striker speed and the three numbers by each engine."""
    paper = quoted().table1.frame
    forces = list(quoted().table1.force_N)
    exact_ones = [strike_for(force, sensor_amplitude) for force in forces]
    solved = {REFERENCE: exact_ones} | strikes_by_codes(exact_ones, forces, sensor_amplitude, runs)
    for engine, simulations in solved.items():
        lower = f"bead_{sensor_pair(simulations[0].case)[1]}"
        strikers = [simulation.case.scene.striker for simulation in simulations]
        paper[engine + STRIKER] = [striker.speed for striker in strikers if striker]
        paper[f"{engine}_speed_m_s"] = [speed_between_sensors(simulation) for simulation in simulations]
        for name in COLUMNS[1:]:
            paper[f"{engine}_{name}"] = [simulation.values[f"{lower}_{name}"] for simulation in simulations]
    return paper


def engines_of(table: pd.DataFrame) -> list[str]:
    """The engines whose columns a table has."""
    return [str(name).removesuffix(STRIKER) for name in table.columns if str(name).endswith(STRIKER)]
