"""Tables of a finished run for notebooks and scripts: observables, contact forces, gauge signals."""

import pandas as pd

from drivers.chain.trace import BALANCES, BORE, BORE_FRICTION, CONTACT
from drivers.run.run_folder import EndedRun
from postproc.read import observables
from postproc.read.sensors import sensor_signals


def observe(run: EndedRun, levels: tuple[float, ...] = observables.LEVELS) -> "pd.Series[float]":
    """Observables of a run: peaks, arrival times, speeds, widths, reflections, energies.

    ``beads observables --definitions`` prints the definition of each.

    Args:
        run: A run from ``drivers.run_scene`` or ``drivers.open_run``.
        levels: Shares of the peak, between 0 and 1, at which durations and widths are cut.

    Returns:
        Series: Values in SI units by name; each name ends in its unit (``wall_peak_N``, ``speed_9_to_5_m_s``). Widths
            are in bead diameters. NaN where the run does not show the observable.

    Raises:
        InputError: The forces of the run are missing or damaged.

    Examples:
        >>> print(observe(run)["wall_peak_N"].round(2))
        16.37
    """
    return pd.Series(observables.observe(run.layout, run.trace, levels), name=run.record.scene_name)


def errors(run: EndedRun) -> pd.DataFrame:
    """Errors of a run: of forces, energy, momentum and every observable of the waves, relative to its true value.

    The true value is that of the scene as written, with all its elements.

    A run is assessed by ``validation.assess``, and by the commands ``run``, ``compare`` and ``report``.

    Args:
        run: A run from ``drivers.run_scene`` or ``drivers.open_run``.

    Returns:
        DataFrame: One row per quantity, named as in ``observe`` without the unit. ``whole`` is the signed error, the
            sum of ``model``, ``rounding``, ``truncation``, ``sampling`` and ``elements``, the effect of elements that
            the accuracy of the scene left out; ``where`` is contact and time of the largest error of the forces, the
            energy or the momentum. Without rows if the run has not been assessed.

    Examples:
        >>> list(errors(run).columns)
        ['whole', 'model', 'rounding', 'truncation', 'sampling', 'elements', 'where']
    """
    parts = ["whole", "model", "rounding", "truncation", "sampling", "elements"]
    table = pd.DataFrame(run.record.error_budget or [], columns=["quantity", *parts, "where"])
    return table.fillna(dict.fromkeys(parts, 0.0)).set_index("quantity")


def forces(run: EndedRun) -> pd.DataFrame:
    """Contact forces, energies and momentum of a run against time, a column for each contact of any chain.

    Args:
        run: A run from ``drivers.run_scene`` or ``drivers.open_run``.

    Returns:
        DataFrame: One row per sample, with ``time_s`` as index. ``contact_j_N`` is the force in contact j, which lies
            under body j, counted from the wall; compression is positive.

    Raises:
        InputError: The forces of the run are missing or damaged.

    Examples:
        >>> print(forces(run)["contact_1_N"].max().round(2))
        16.37
    """
    trace = run.trace
    by_body = [(CONTACT, trace.force_N), *([(BORE, trace.bore_N)] if trace.bore_N is not None else [])]
    single = {name: getattr(trace, name) for name in BALANCES}
    single |= {BORE_FRICTION: trace.bore_friction_N} if trace.bore_friction_N is not None else {}
    table = pd.DataFrame(single, index=pd.Index(trace.time_s, name="time_s"))
    for pattern, values in reversed(by_body):
        names = [pattern.format(number) for number in range(1, values.shape[1] + 1)]
        table = pd.DataFrame(values, table.index, names).join(table)
    return table


def gauges(run: EndedRun) -> pd.DataFrame:
    """Forces that the gauges of a run show against time.

    Args:
        run: A run from ``drivers.run_scene`` or ``drivers.open_run``.

    Returns:
        DataFrame: One row per sample, with ``time_s`` as index; a column for each gauge, ``bead_9_N``, ...,
            ``wall_N``. A sensor bead shows the mean of its two contact forces, behind the electronics of the scene's
            ``sensor.time_constant``.

    Raises:
        InputError: The forces of the run are missing or damaged.

    Examples:
        >>> list(gauges(run).columns)
        ['bead_9_N', 'bead_5_N', 'wall_N']
    """
    columns = {f"{name}_N": signal for name, signal in sensor_signals(run.layout, run.trace).items()}
    return pd.DataFrame(columns, index=pd.Index(run.trace.time_s, name="time_s"))
