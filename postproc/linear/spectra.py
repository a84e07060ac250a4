"""Spectra of a run: amplitudes, spectrogram, transfer function and harmonics of the drive, and their figure.

Amplitude spectra are scaled by the mean of the window, so that a sine of amplitude A at a frequency of the spectrum
shows A. The resolution is 1 divided by the length of the record; the window makes a line wider (Harris, Proc. IEEE
66:51, 1978): hann by 4 such steps between its zeros, boxcar by 2.

Harmonics are fitted to the later half of the driven interval, without silence before and after it and with fewer
transients. In each signal this interval begins and ends later than the drive by the delay of its onset, and is cut at
the end of the record.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from math import floor, inf, nan, pi
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.scene.model import DriveTable
from postproc.draw.plot import PAGE_IN, Product, colour_map, letter_panel, pyplot
from postproc.linear.modes import bands_at_loads, edges_Hz, shade_bands
from postproc.read.signals import sensor_signals

PARTS = 16  # of a record, in the windows of its spectrogram
HARMONICS = 5
LEAST_AMPLITUDE = 1e-6  # of the largest of the source: smaller ones give no transfer function
ONSET_SHARE = 0.01  # of its largest value: a signal has begun when it is larger
DRIVE = "drive"  # name of the drive among the signals
LEAST_SAMPLES = 16
DECADES = 6  # of amplitudes in figures
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#999999")


@dataclass(frozen=True)
class Analysis:
    """Spectra of one run.

    Attributes:
        source, target: names of the signals of the transfer function; equal if the run has only one.
        window: window of the spectra.
        time_s: times used. Shape (samples,).
        signals: changes of the signals since time 0 by name, at these times.
        units: units of the signals by name.
        table: amplitude of each signal against frequency, with the transfer function.
        harmonics: of each signal, as of ``harmonics_of``; none without a frequency.
    """

    source: str
    target: str
    window: str
    time_s: Array
    signals: Mapping[str, Array]
    units: Mapping[str, str]
    table: pd.DataFrame
    harmonics: Mapping[str, pd.DataFrame]

    def amplitude(self, name: str) -> "pd.Series[float]":
        """Amplitude spectrum of a signal, by frequency in Hz."""
        return self.table.set_index("frequency_Hz")[f"{name}_amplitude_{self.units[name]}"]

    @property
    def numbers(self) -> dict[str, Any]:
        """Resolution, strongest lines and harmonics by signal."""
        spectra = {name: self.amplitude(name) for name in self.units}
        return {
            "samples": len(self.time_s), "window": self.window, "resolution_Hz": float(self.table["frequency_Hz"][1]),
            "strongest": {
                name: {"frequency_Hz": spectrum.idxmax(), f"amplitude_{self.units[name]}": spectrum.max()}
                for name, spectrum in spectra.items()
            },
            "harmonics": {name: rows.to_dict("records") for name, rows in self.harmonics.items()},
        }  # fmt: skip


def spectrum_of(signal: Array, window: str = "hann") -> NDArray[np.complex128]:
    """Complex amplitudes of a signal without its mean, at the frequencies of ``np.fft.rfftfreq``."""
    from scipy.signal import get_window

    weights = get_window(window, len(signal))
    return np.asarray(2 * np.fft.rfft(weights * (signal - signal.mean())) / weights.sum())


def spectrogram_of(time_s: Array, signal: Array, window: str = "hann") -> tuple[Array, Array, Array]:
    """Times, frequencies and amplitudes of a spectrogram, from windows of a ``PARTS``th of the record that overlap.

    Frequencies between those of the window are interpolated by zeros after its samples. Shapes (times,),
    (frequencies,), (frequencies, times).
    """
    from scipy.signal import spectrogram

    length = min(max(len(signal) // PARTS, 8), len(signal))
    frequency, time, power = spectrogram(
        signal - signal.mean(), _rate_Hz(time_s), window=window, nperseg=length, noverlap=length * 3 // 4,
        nfft=8 * length, detrend=False, scaling="spectrum",
    )  # fmt: skip
    return np.asarray(time) + float(time_s[0]), np.asarray(frequency), np.sqrt(2 * np.asarray(power))


def transfer_of(source: NDArray[np.complex128], target: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Transfer function of two spectra over the whole record, which is ``S_xy / S_xx`` and their quotient.

    It is NaN where the amplitude of the source is below ``LEAST_AMPLITUDE`` of its largest.
    """
    seen = np.abs(source) > LEAST_AMPLITUDE * np.abs(source).max()
    return np.asarray(np.divide(target, source, np.full(len(source), np.nan + 0j), where=seen))


def harmonics_of(time_s: Array, signal: Array, frequency_Hz: float, envelope: Array | None = None) -> pd.DataFrame:
    """Parts ``amplitude sin(2 pi frequency t + phase)`` of a signal at a frequency and its multiples.

    They are fitted by least squares to the later half of the last whole periods, or, with an envelope, to all of these.
    Multiples above half the sampling rate are left out.

    Args:
        time_s: equally spaced times. Shape (samples,).
        signal: shape (samples,).
        frequency_Hz: lowest frequency.
        envelope: factor of all parts, the window of a burst. Shape (samples,).

    Returns:
        A row for each part. ``change_share`` is the change from the earlier to the later half of the periods, in
        amplitude and phase, as a share of the amplitude: 0 for a steady signal, NaN for a single period.

    Raises:
        ValueError: the record is shorter than a period, or has fewer than four samples a period.
    """
    length = float(np.ptp(time_s)) if len(time_s) else 0.0
    periods = floor(length * frequency_Hz * (1 + 1e-12))
    if periods < 1:
        raise ValueError(f"the record of {length:.4g} s is shorter than a period of {1 / frequency_Hz:.4g} s")
    if (rate := _rate_Hz(time_s)) < 4 * frequency_Hz:
        raise ValueError(f"{rate / frequency_Hz:.3g} samples a period of {frequency_Hz:g} Hz, at least 4 are needed")
    orders = np.array([order for order in range(1, HARMONICS + 1) if 2 * order * frequency_Hz < 0.99 * rate])
    angles = 2 * pi * frequency_Hz * np.multiply.outer(time_s, orders)
    waves = np.hstack([np.sin(angles), np.cos(angles)]) * (1.0 if envelope is None else envelope[:, np.newaxis])
    columns = np.column_stack([np.ones(len(time_s)), waves])

    def fitted(first: int, last: int) -> Array:
        """Complex amplitudes in the periods from ``first`` to ``last``, counted back from the end of the record."""
        back = (time_s[-1] - time_s) * frequency_Hz
        used = (back >= last * (1 - 1e-12) - 1e-9) & (back <= first * (1 + 1e-12))
        sine, cosine = np.linalg.lstsq(columns[used], signal[used])[0][1:].reshape(2, -1)
        return np.asarray(sine + 1j * cosine)

    half = periods // 2
    parts = fitted(half or 1 if envelope is None else periods, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.abs(fitted(half, 0) - fitted(2 * half, half)) / np.abs(parts) if half else np.full(len(orders), nan)
    return pd.DataFrame({
        "frequency_Hz": orders * frequency_Hz, "amplitude": np.abs(parts), "phase_rad": np.angle(parts),
        "change_share": change,
    })  # fmt: skip


def signals_of(case: Case, trace: Trace) -> dict[str, Array]:
    """Changes of the gauges' signals since time 0 in N, and the drive, in N or m, by name."""
    readings = sensor_signals(case.layout, trace)
    signals = {name: reading - reading[0] for name, reading in readings.items()}
    drive = case.chain.drive
    return signals if drive is None else {DRIVE: drive.at(trace.time_s)[0], **signals}


def driven_interval(table: DriveTable, time_s: Array, drive: Array, signal: Array) -> tuple[float, float]:
    """Begin and end of the driven interval of a signal in s, from all samples of a sine drive and of the signal."""
    duration_s = table.duration or (table.cycles / table.frequency if table.cycles and table.frequency else inf)
    started, arrived = (np.abs(values) > ONSET_SHARE * np.abs(values).max() for values in (drive, signal))
    begin_s = table.start + max(float(time_s[np.argmax(arrived)] - time_s[np.argmax(started)]), 0.0)
    return begin_s, begin_s + duration_s


def analyse(
    case: Case, trace: Trace, ends: Sequence[str], window: str, frequency_Hz: float | None, span_s: tuple[float, float]
) -> Analysis:
    """Spectra of the gauges of a run and of its drive.

    Args:
        case: the case.
        trace: the run.
        ends: names of the source and the target of the transfer function; empty for the drive, or else the highest
            gauge, and for the lowest gauge.
        window: name of the window.
        frequency_Hz: frequency for the harmonics; None for that of the drive.
        span_s: first and last time used.

    Raises:
        ValueError: the record is too short.
    """
    whole, table, drive = signals_of(case, trace), case.scene.drive, case.chain.drive
    used = (trace.time_s >= span_s[0]) & (trace.time_s <= span_s[1])
    time_s, signals = trace.time_s[used], {name: values[used] for name, values in whole.items()}
    if len(time_s) < LEAST_SAMPLES:
        raise ValueError(f"{len(time_s)} samples, at least {LEAST_SAMPLES} are needed")
    units = dict.fromkeys(signals, "N") | ({DRIVE: "m"} if drive is not None and drive.prescribed else {})
    own_Hz = table.frequency if table is not None and table.form == "sine" else None
    lowest_Hz, harmonics = frequency_Hz or own_Hz or 0.0, dict[str, pd.DataFrame]()
    for name in signals if lowest_Hz else ():
        driven, envelope = np.ones(len(time_s), bool), None
        if table is not None and lowest_Hz == own_Hz:
            begin_s, end_s = driven_interval(table, trace.time_s, whole[DRIVE], whole[name])
            driven = (time_s >= begin_s) & (time_s <= end_s * (1 + 1e-12))
            if table.window == "hann":
                envelope = np.sin(pi * (time_s[driven] - begin_s) / (end_s - begin_s)) ** 2
        try:
            harmonics[name] = harmonics_of(time_s[driven], signals[name][driven], lowest_Hz, envelope)
        except ValueError:  # the driven interval may lie outside the record
            if driven.all():
                raise
    spectra = {name: spectrum_of(values, window) for name, values in signals.items()}
    columns = {"frequency_Hz": np.fft.rfftfreq(len(time_s), 1 / _rate_Hz(time_s))}
    columns |= {f"{name}_amplitude_{units[name]}": np.abs(values) for name, values in spectra.items()}
    source, target = ends[0] or next(iter(signals)), ends[1] or [*signals][-1]
    if source != target:
        transfer = transfer_of(spectra[source], spectra[target])
        columns |= {"transfer": np.abs(transfer), "transfer_phase_rad": np.angle(transfer)}
    return Analysis(source, target, window, time_s, signals, units, pd.DataFrame(columns), harmonics)


def spectrum_product(case: Case, analysis: Analysis, title: str) -> Product:
    """Figure and table of the spectra, with the lines to print."""
    figure, axes = pyplot().subplots(1, 3, figsize=(PAGE_IN, 3.0), layout="constrained", width_ratios=(1.2, 1, 1.1))
    bands = bands_at_loads(case)
    frequency_Hz, last_Hz = analysis.table["frequency_Hz"].to_numpy(), 0.0
    letter_panel(axes[0], "a", "amplitudes")
    for name, colour in zip(analysis.signals, cycle(COLOURS), strict=False):
        share = analysis.amplitude(name).to_numpy() / (analysis.amplitude(name).max() or 1.0)
        axes[0].plot(frequency_Hz / 1e3, share, color=colour, lw=0.9, label=name.replace("_", " "))
        last_Hz = max(last_Hz, frequency_Hz[share > 10.0 ** -(DECADES / 2)].max(initial=0.0))
    axes[0].set(yscale="log", ylim=(10.0**-DECADES, 2), ylabel="amplitude / largest")
    axes[0].legend(loc="upper right")
    letter_panel(axes[1], "b", f"{analysis.target} / {analysis.source}".replace("_", " "))
    if analysis.source != analysis.target:
        transfer = analysis.table["transfer"]
        axes[1].plot(frequency_Hz / 1e3, transfer, color=COLOURS[0], lw=0.9)
        axes[1].set(yscale="log" if transfer.fillna(0).any() else "linear")
    letter_panel(axes[2], "c", analysis.target.replace("_", " "))
    time, frequency, power = spectrogram_of(analysis.time_s, analysis.signals[analysis.target], analysis.window)
    level = np.log10(np.maximum(power / (power.max() or 1.0), 10.0**-DECADES))
    mesh = axes[2].pcolormesh(1e3 * time, frequency / 1e3, level, cmap=colour_map("value"), rasterized=True)
    figure.colorbar(mesh, ax=axes[2], label="log10 (amplitude / largest)")
    # above the bands, or where all amplitudes stay small
    edge_Hz = edges_Hz(bands[-1]).max() if bands else 0.0
    highest = max(1.2 * edge_Hz, min(1.2 * last_Hz, frequency_Hz[-1])) / 1e3
    for axis in axes[:2]:
        shade_bands(axis.axvspan, bands)
        axis.set(xlabel="frequency (kHz)", xlim=(0, highest))
    axes[2].set(xlabel="time (ms)", ylabel="frequency (kHz)", ylim=(0, highest))
    figure.suptitle(title)
    return Product(figure, analysis.table, notes=[*_lines(analysis)])


def _lines(analysis: Analysis) -> Iterator[str]:
    frequency_Hz, time, harmonics = analysis.table["frequency_Hz"], analysis.time_s, analysis.harmonics
    yield (
        f"{len(time)} samples from {time[0]:g} to {time[-1]:g} s, window {analysis.window}, "
        f"resolution {frequency_Hz[1]:.5g} Hz, {PARTS} times as coarse in the spectrogram, "
        f"up to {frequency_Hz.iloc[-1]:.5g} Hz"
    )
    for name, spectrum in ((name, analysis.amplitude(name)) for name in analysis.units):
        yield f"{name}: strongest at {spectrum.idxmax():.5g} Hz, {spectrum.max():.4g} {analysis.units[name]}"
    if not harmonics:
        yield from ["no harmonics: no whole period of a sine of the drive in this record"] * (DRIVE in analysis.units)
        return
    yield "harmonics in the driven interval, A sin(2 pi f t + phase), and their change in it as a share of A"
    rows = pd.concat(harmonics, names=["signal", None]).reset_index("signal")
    yield from rows.to_string(index=False, float_format="{:.6g}".format).splitlines()
    source, target = analysis.source, analysis.target
    if source != target and {source, target} <= harmonics.keys():
        one, two = (harmonics[name].iloc[0] for name in (source, target))
        ratio = two.amplitude / one.amplitude * np.exp(1j * (two.phase_rad - one.phase_rad))
        unit = f"{analysis.units[target]}/{analysis.units[source]}"
        yield f"transfer from {source} to {target}: {abs(ratio):.6g} {unit}, phase {np.angle(ratio):.5f} rad"


def _rate_Hz(time_s: Array) -> float:
    """Samples per second of equally spaced times."""
    return float((len(time_s) - 1) / (time_s[-1] - time_s[0]))
