"""Time steps and samples: a time step has to divide the sample interval."""

from drivers.base.errors import InputError

WHOLE = 1e-9  # relative: a step written with ten digits still divides its interval


def steps_per_sample(interval_s: float, step_s: float | None, where: str) -> tuple[int, float]:
    """Steps from one sample to the next, and the time step as the exact part of the interval.

    Without a time step, which is then to be chosen, the interval itself.

    Raises:
        InputError: the step does not divide the interval; the nearest that does is named.
    """
    if step_s is None:
        return 1, interval_s
    ratio = interval_s / step_s
    every = max(1, round(ratio))
    if abs(ratio - every) > WHOLE * every:
        nearest = f'"{_in_us(interval_s / every)} us"'
        raise InputError(
            where,
            "run.time_step",
            f"{step_s:g} s, which does not divide run.sample_interval = {interval_s:g} s",
            f"for instance {nearest}",
        )
    return every, step_s if step_s * every == interval_s else interval_s / every


def _in_us(seconds: float) -> str:
    return f"{seconds * 1e6:.12g}"
