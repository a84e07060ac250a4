"""Figure, table and lines of the spectra of a run: gauges, transfer function, spectrogram, harmonics of the drive."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.terminal import text_table
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.draw.product import Product
from postproc.draw.style import PAGE_IN, letter_panel, pyplot, value_colours
from postproc.linear.modes import Bands, bands_of, static_forces_N
from postproc.linear.modes_figure import shade_bands
from postproc.linear.spectra import PARTS, Harmonic, Spectrum, harmonics_of, spectrogram_of, spectrum_of, transfer_of
from postproc.read.signals import sensor_signals

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
        spectra: amplitude spectra by name.
        frequency_Hz: frequency whose harmonics are measured; None without one.
        harmonics: by name.
    """

    source: str
    target: str
    window: str
    time_s: Array
    signals: Mapping[str, Array]
    units: Mapping[str, str]
    spectra: Mapping[str, Spectrum]
    frequency_Hz: float | None
    harmonics: Mapping[str, list[Harmonic]]


def signals_of(case: Case, trace: Trace) -> dict[str, Array]:
    """Changes of the gauges' signals since time 0 in N, and the drive, in N or m, by name."""
    readings = sensor_signals(case.layout, trace)
    signals = {name: reading - reading[0] for name, reading in readings.items()}
    drive = case.chain.drive
    return signals if drive is None else {DRIVE: drive.at(trace.time_s)[0], **signals}


def analyse(
    case: Case,
    signals: Mapping[str, Array],
    time_s: Array,
    ends: tuple[str, str],
    window: str,
    frequency_Hz: float | None,
) -> Analysis:
    """Spectra of signals at equally spaced times.

    Args:
        case: the case.
        signals: signals by name, as from ``signals_of``.
        time_s: times. Shape (samples,).
        ends: names of the source and the target of the transfer function; empty for the drive, or else the highest
            gauge, and for the lowest gauge.
        window: name of the window.
        frequency_Hz: frequency for the harmonics; None for that of the drive.

    Raises:
        ValueError: the record is too short.
    """
    if len(time_s) < LEAST_SAMPLES:
        raise ValueError(f"{len(time_s)} samples, at least {LEAST_SAMPLES} are needed")
    names = [*signals]
    table = case.scene.drive
    if frequency_Hz is None and table is not None and table.form == "sine":
        frequency_Hz = table.frequency
    drive = case.chain.drive
    units = {name: "m" if name == DRIVE and drive is not None and drive.prescribed else "N" for name in names}
    harmonics = {name: harmonics_of(time_s, signals[name], frequency_Hz) for name in names} if frequency_Hz else {}
    spectra = {name: spectrum_of(time_s, signals[name], window) for name in names}
    source, target = ends[0] or names[0], ends[1] or names[-1]
    return Analysis(source, target, window, time_s, signals, units, spectra, frequency_Hz, harmonics)


def spectrum_product(case: Case, analysis: Analysis, title: str) -> Product:
    """Figure and table of the spectra, with the lines to print."""
    figure, axes = pyplot().subplots(1, 3, figsize=(PAGE_IN, 3.0), layout="constrained", width_ratios=(1.2, 1, 1.1))
    bands, amplitudes = _bands(case), analysis.spectra
    table = pd.DataFrame({"frequency_Hz": amplitudes[analysis.target].frequency_Hz})
    letter_panel(axes[0], "a", "amplitudes")
    shade_bands(axes[0].axvspan, bands)
    for (name, spectrum), colour in zip(amplitudes.items(), cycle(COLOURS), strict=False):
        share = spectrum.amplitude / (spectrum.amplitude.max() or 1.0)
        axes[0].plot(spectrum.frequency_Hz / 1e3, share, color=colour, lw=0.9, label=name.replace("_", " "))
        table[f"{name}_amplitude_{analysis.units[name]}"] = spectrum.amplitude
    axes[0].set(yscale="log", ylim=(10.0**-DECADES, 2), ylabel="amplitude / largest")
    axes[0].legend(frameon=False, loc="upper right")
    letter_panel(axes[1], "b", f"{analysis.target} / {analysis.source}".replace("_", " "))
    shade_bands(axes[1].axvspan, bands)
    if analysis.source != analysis.target:
        frequency, transfer = transfer_of(
            analysis.time_s, analysis.signals[analysis.source], analysis.signals[analysis.target], analysis.window
        )
        table["transfer"], table["transfer_phase_rad"] = np.abs(transfer), np.angle(transfer)
        axes[1].plot(frequency / 1e3, np.abs(transfer), color=COLOURS[0], lw=0.9)
        axes[1].set(yscale="log" if np.nan_to_num(np.abs(transfer)).any() else "linear")
    letter_panel(axes[2], "c", analysis.target.replace("_", " "))
    time, frequency, power = spectrogram_of(analysis.time_s, analysis.signals[analysis.target], analysis.window)
    level = np.log10(np.maximum(power / (power.max() or 1.0), 10.0**-DECADES))
    mesh = axes[2].pcolormesh(1e3 * time, frequency / 1e3, level, cmap=value_colours(), rasterized=True)
    figure.colorbar(mesh, ax=axes[2], label="log10 (amplitude / largest)")
    axes[2].set(xlabel="time (ms)", ylabel="frequency (kHz)")
    highest = _highest_Hz(amplitudes, bands) / 1e3
    for axis in axes[:2]:
        axis.set(xlabel="frequency (kHz)", xlim=(0, highest))
    axes[2].set_ylim(0, highest)
    figure.suptitle(title)
    return Product(figure, table, notes=[*_lines(analysis)])


def _bands(case: Case) -> list[Bands]:
    """Bands of the pattern at the largest static force between beads; none without a load or a pattern."""
    static = static_forces_N(case.chain)[1:]
    try:
        return [bands_of(case, float(static.max()))] if static.size and static.max() > 0 else []
    except ValueError:
        return []


def _highest_Hz(spectra: Mapping[str, Spectrum], bands: list[Bands]) -> float:
    """Upper end of the frequency axis: above the bands, or where all amplitudes stay small."""
    last = 0.0
    for spectrum in spectra.values():
        high = np.flatnonzero(spectrum.amplitude > 10.0 ** -(DECADES / 2) * spectrum.amplitude.max())
        last = max(last, float(spectrum.frequency_Hz[high[-1]])) if high.size else last
    edge = float(bands[-1].edges_Hz.max()) if bands else 0.0
    return max(1.2 * edge, min(1.2 * last, float(next(iter(spectra.values())).frequency_Hz[-1])))


def _lines(analysis: Analysis) -> Iterator[str]:
    time, spectrum = analysis.time_s, analysis.spectra[analysis.target]
    yield (
        f"{len(time)} samples from {time[0]:g} to {time[-1]:g} s, window {analysis.window}, "
        f"resolution {spectrum.resolution_Hz:.5g} Hz, {PARTS} times as coarse in the spectrogram, "
        f"up to {spectrum.frequency_Hz[-1]:.5g} Hz"
    )
    for name, shown in analysis.spectra.items():
        place = int(np.argmax(shown.amplitude))
        strongest = f"{shown.frequency_Hz[place]:.5g} Hz, {shown.amplitude[place]:.4g} {analysis.units[name]}"
        yield f"{name}: strongest at {strongest}"
    if analysis.frequency_Hz is not None:
        yield f"harmonics of {analysis.frequency_Hz:g} Hz in the last whole periods, A sin(2 pi f t + phase)"
        rows = [("signal", "frequency", "amplitude", "phase")]
        for name, parts in analysis.harmonics.items():
            rows += [
                (
                    name,
                    f"{part.frequency_Hz:.6g} Hz",
                    f"{part.amplitude:.6g} {analysis.units[name]}",
                    f"{part.phase_rad:.5f} rad",
                )
                for part in parts
            ]
        yield from text_table(rows)
        if analysis.source != analysis.target:
            start, end = (analysis.harmonics[name][0] for name in (analysis.source, analysis.target))
            turn = float(np.angle(np.exp(1j * (end.phase_rad - start.phase_rad))))
            unit = f"{analysis.units[analysis.target]}/{analysis.units[analysis.source]}"
            ratio = end.amplitude / start.amplitude if start.amplitude else float("nan")
            yield f"transfer from {analysis.source} to {analysis.target}: {ratio:.6g} {unit}, phase {turn:.5f} rad"


def numbers_of(analysis: Analysis) -> dict[str, Any]:
    """Lines as numbers: resolution, strongest lines and harmonics by signal."""
    strongest = {name: int(np.argmax(spectrum.amplitude)) for name, spectrum in analysis.spectra.items()}
    return {
        "samples": len(analysis.time_s), "window": analysis.window,
        "resolution_Hz": analysis.spectra[analysis.target].resolution_Hz,
        "strongest": {
            name: {"frequency_Hz": float(analysis.spectra[name].frequency_Hz[place]),
                   f"amplitude_{analysis.units[name]}": float(analysis.spectra[name].amplitude[place])}
            for name, place in strongest.items()
        },
        "harmonics": {name: [vars(part) for part in parts] for name, parts in analysis.harmonics.items()},
    }  # fmt: skip
