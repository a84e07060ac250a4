"""Arguments and options, each declared once, and the commands by section, in the order in which a user meets them."""

import os
from collections.abc import Callable
from functools import partial
from inspect import cleandoc
from pathlib import Path

import click

from drivers.base import paths
from postproc.figures import captions
from validation.commands.options import act, argument, file_to_write, instead, number, option

RUNS = "Folder of the run folders (default: runs/ of the checkout)."
HELP_OPTIONS = {"help_option_names": ["-h", "--help"]}


def _engines_file(text: str) -> Path:
    """Path of ``--engines``; adds the engines of that file for this process and its child processes."""
    path = Path(text).absolute()
    os.environ[paths.ENGINES_VARIABLE] = str(path)
    return path


def _by_word(*declared: click.Parameter) -> dict[str, click.Parameter]:
    """Options by name, and arguments by their placeholder."""
    return {str(each.metavar) if isinstance(each, click.Argument) else each.opts[0]: each for each in declared}


PARAMETERS = _by_word(
    argument("scene", "SCENE", "A scene file, or the name of a scene in inputs/scenes."),
    argument("study", "STUDY", "A study file, or the name of a study in inputs/studies."),
    argument("run", "RUN", "A run folder, or ENGINE:SCENE for the newest run of that scene."),
    option(
        "--set settings KEY=VALUE ...",
        "A key of the scene with its value, such as chain.count=60 or run.time_step='10 ns'; an empty value removes "
        "the key; runs lists runs with this setting, where * is any text; repeatable.",
    ),
    option(
        "--engine engines ENGINE ...",
        "Take this engine only; repeatable (default: all that are installed, or those of the study).",
    ),
    option(
        "--engines engines_file FILE",
        "File with engines of your own, as well as those of each engines.toml (see drivers/README.md).",
        type=_engines_file,
        is_eager=True,
        expose_value=False,
    ),
    option("--require ENGINE ...", "Fail if this engine does not run; repeatable."),
    option("--allow-missing", "Accept that engines of --engine or all codes are missing."),
    option("--runs DIR", RUNS, default=lambda: paths.RUNS),
    option(
        "--results DIR",
        "Folder for tables and figures (default: results/ of the checkout).",
        default=lambda: paths.RESULTS,
    ),
    option("--unsafe", "Accept a scene that a guard refuses, for instance a time step above the stability limit."),
    option(
        "--measured FILE",
        "CSV file with forces in N, in columns named after gauges, such as bead_9 [N] (default: the [[measured]] "
        "tables of the scene, for any other file).",
    ),
    option(
        "--frames N",
        "Number of times (default: 12 in a film, 100 for ParaView).",
        type=number(int, lambda count: 2 <= count <= 10_000, "whole numbers from 2 to 10000"),
    ),
    option(
        "--quick",
        "Do less: fewer scenes, steps and seeds, no long runs; for fit no profiles, no data left out, no runs of the "
        "codes.",
    ),
    option(
        "--only patterns PATTERN ...",
        "Take only cases with KEY=GLOB, such as 'striker.speed=2 m/s', or with a label that matches; repeatable "
        "(default: all cases).",
    ),
    option("--dry-run", "Print what would be done, without doing it."),
    option("--json as_json", "Print JSON."),
    option(
        "--dask ADDRESS",
        "Run on the Dask cluster at ADDRESS; without ADDRESS, on a local Dask cluster.",
        is_flag=False,
        flag_value="local",
        default="",
    ),
    option(
        "--list every",
        "Print the state of each case: done, failed, timeout, refused, stale, claimed, to do, not installed.",
    ),
    option(
        "--free KEY[=LOW..HIGH] ...",
        "Fit this key of the scene, such as contact.restitution=0.5..1, or with prior knowledge striker.speed=2±1%; "
        "repeatable (default bounds: inputs/calibration.toml).",
    ),
    option(
        "--law laws LAW ...",
        "Fit this contact law of inputs/calibration.toml (elastic, viscoelastic, power); repeatable: all on the same "
        "data, and compared.",
    ),
    option(
        "--level levels X ...",
        "Measure widths at this share of the peak; repeatable (default: 0.002 and 0.04).",
        type=number(float, lambda share: 0 < share < 1, "a share of the peak, above 0 and below 1"),
    ),
    option(
        "--predict OBSERVABLE ...",
        "Predict this observable, such as wall_peak or bead_8_reflected_arrival, with its error; repeatable.",
    ),
    option(
        "--quoted SET,...",
        "Fit to data that the paper quotes: sets of inputs/calibration.toml, such as fig4,table1.",
        type=lambda text: tuple(name.strip() for name in text.split(",")) if text else (),
        default="",
    ),
    option(
        "--beads ranges A-B ...", "Energy of the bodies A to B, counted from the wall, the striker last; repeatable."
    ),
    argument(
        "what",
        "SCENE|RUN...",
        "Scenes by name or file, or exactly two runs: run folders, or ENGINE:SCENE for the newest run.",
        required=True,
    ),
    option(
        "--scene SCENE",
        "Scene of the deck before changes, by name or file (default: the one that render wrote into FOLDER).",
    ),
    option(
        "--sideways X",
        "Multiply displacements from the axis by X (default: 1).",
        default=1.0,
        type=number(float, lambda factor: 0 < factor <= 1e6, "a factor above 0, up to 1e6"),
    ),
    option(
        "--studies",
        "Write the page first, then make figures and studies and add them; short studies where no table exists.",
    ),
    argument(
        "table",
        "[TABLE]",
        "A table, such as chain.bead or axis, or a file: scene, study, engines (default: all files).",
        default="",
    ),
    option("--markdown", "Print the tables in Markdown."),
    option("--write", "Write the tables of all files into inputs/README.md."),
    option("--rerun", "Run again even if the run is done or, with auto, failed."),
    option("--time-limit SECONDS", "Stop a run after this time (default: by beads and steps)."),
    instead("--definitions", "Print the definitions of all observables and exit.", "run_commands", "definitions"),
    option("--from source SIGNAL", "Source of the transfer function: drive, or a gauge.", default=""),
    option("--to target SIGNAL", "Target of the transfer function: a gauge, such as wall.", default=""),
    option("--frequency F", "Measure harmonics of this frequency (default: that of a sine drive)."),
    option("--since TIME", "Begin of the record, such as '0.2 ms' (default: 0 s).", default="0 s"),
    option("--until TIME", "End of the record (default: that of the run)."),
    option("--window NAME", "hann (default), boxcar, blackmanharris or flattop.", default="hann"),
    argument("run", "SCENE|RUN", "A scene, for its exact motion; or a run folder, or ENGINE:SCENE."),
    option("--own KEY[=LOW..HIGH] ...", "As --free, with a value of its own for each data set; repeatable."),
    option("--workers N", "Number of processes on this machine (default: number of cores)."),
    option("--retry", "Run failed cases again."),
    option("--yes", "Accept a study of more than 20,000 cases."),
    option("--slice part I/N", "Run part I of N here, without writing the table."),
    option("--slurm", "Run as a Slurm job array."),
    option("--slices N", "Number of tasks of the job array (default: by the expected time)."),
    option("--slurm-line lines LINE ...", "Add a line to the job script, such as '#SBATCH --mem=2G'; repeatable."),
    option("--wait", "Wait for the job array, then write the table."),
    option("--x COLUMN", "Draw --y against this column of the table.", default=""),
    option("--y COLUMN", "Column of numbers; a name may be without its unit.", default=""),
    option("--log", "Make the axes of --x and --y logarithmic."),
    option("--power-law", "Fit y = C x^n to each curve of each engine."),
    argument("case", "CASE", "Number of the case, as in the table of the study."),
    option("--prune", "Remove runs that are not done, or whose build or deck is not today's."),
    option("--out DIR", "Folder for the deck.", required=True),
    argument("folder", "FOLDER", "Folder with a deck that was run by hand, and its output."),
    argument("names", "[NAME]...", "Figures of the paper (default: all), or Python files."),
    option("--file FILE", "Judge the cases of a file alone (default: all claims and inputs/independent.toml)."),
    option("--budget budget_s SECONDS", "Engine time of all runs together (default: 300 s; 30 s with --quick)."),
    argument("name", "ENGINE", "Name of an engine, such as verlet or an entry of your engines.toml."),
)
PARAMETERS |= {  # further ones of the same name or placeholder
    "--runs-read": option("--runs DIR", RUNS, default=lambda: paths.RUNS, type=Path),
    "--out-file": option("--out FILE", "Page to write (default: results/report.html).", type=file_to_write),
    "ALL": argument("scenes", "[SCENE]...", "Scenes by name or file (default: all)."),
    "QUOTED": argument("scenes", "[SCENE]...", "Scenes by name or file (default: the scenes of --quoted)."),
    "PAPER": argument("scenes", "[SCENE]...", "Scenes by name or file (default: the paper's four)."),
}


class _Figures(click.Command):
    """Command whose help lists the figures."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Figures"):
            formatter.write_dl([(name, caption.title) for name, caption in captions().items()])
        super().format_epilog(ctx, formatter)


def command(
    module: str,
    usage: str,
    *,
    action: str = "",
    engines: bool = True,
    kind: type[click.Command] = click.Command,
) -> Callable[[Callable[[], None]], click.Command]:
    """Make a command of a function without a body: its name, and its docstring with examples at the end as help.

    The command imports a module when it is called, and hands its arguments and options to a function there.

    Args:
        module: module of this package.
        usage: words of ``PARAMETERS``.
        action: name of the function in the module; empty for that of the function without a body.
        engines: True if the command loads engines, so that it has the option ``--engines``.
        kind: class of the command.
    """

    def decorate(declared: Callable[[], None]) -> click.Command:
        text, _, examples = cleandoc(declared.__doc__ or "").partition("\n\nExample")
        return kind(
            declared.__name__.rstrip("_"),  # import_ is a command
            callback=partial(act, module, action or declared.__name__),
            params=[PARAMETERS[word] for word in [*usage.split(), *["--engines"] * engines]],
            help=text,
            epilog=f"\b\nexample{examples}",
            context_settings=HELP_OPTIONS,
        )

    return decorate


@command("key_commands", "", engines=False)
def scenes() -> None:
    """List the shipped scenes, studies and materials.

    Example:
      beads scenes
    """


@command("key_commands", "[TABLE] --markdown --write", engines=False)
def keys() -> None:
    """List keys of scenes and studies, with units and ranges.

    Examples:
      beads keys chain
      beads keys study --markdown
    """


@command("run_commands", "SCENE --set --engine")
def plan() -> None:
    """Print time step, expected errors and cost of a scene.

    Examples:
      beads plan fig4
      beads plan fig4 --set run.time_step= --set run.accuracy=1e-4
    """


@command("draw_commands", "SCENE --set --results")
def draw() -> None:
    """Draw a scene to scale.

    Examples:
      beads draw fig4
      beads draw fig4 --set chain.count=5 --results drawings
    """


@command("draw_commands", "SCENE --set --results")
def modes() -> None:
    """Draw linear modes of a scene, print bands and sound speed.

    Examples:
      beads modes steel-chain --set chain.precompression='10 N'
      beads modes dimer
    """


@command("run_commands", "SCENE --set --engine --runs --rerun --time-limit --unsafe")
def run() -> None:
    """Run a scene and print the run folders.

    --engine auto takes the cheapest engine that models the scene, after those whose build or run failed the next
    one.

    Examples:
      beads run fig4 --engine yade
      beads run fig4 --engine auto
      beads run fig4 --set chain.count=60 --set run.time_step='50 ns'
    """


@command("run_commands", "SCENE|RUN... --set --engine --runs --require --allow-missing --unsafe")
def compare() -> None:
    """Run scenes and judge them on every engine, or compare runs.

    Examples:
      beads compare fig4
      beads compare fig4 --set run.time_step='1 us'
      beads compare yade:fig4 liggghts:fig4
    """


@command("run_commands", "RUN --runs-read --level --json --definitions")
def observables() -> None:
    """Print peaks, speeds, widths, reflections, energies of a run.

    Examples:
      beads observables yade:fig4
      beads observables yade:fig4 --level 0.1 --json
    """


@command("draw_commands", "RUN --runs-read --results")
def spacetime() -> None:
    """Draw the force in every contact of a run against time.

    Example:
      beads spacetime yade:fig4
    """


@command("draw_commands", "RUN --from --to --frequency --since --until --window --json --runs-read --results")
def spectrum() -> None:
    """Draw spectra and a transfer function of the gauges of a run.

    Examples:
      beads spectrum yade:driven-steel
      beads spectrum yade:driven-steel --from bead_15 --to wall --since '0.2 ms'
    """


@command("draw_commands", "RUN --beads --runs-read --results")
def energy() -> None:
    """Draw the energy of each bead (needs recorded positions).

    Examples:
      beads energy verlet:fig4
      beads energy verlet:fig4 --beads 1-5 --beads 6-21
    """


@command("draw_commands", "RUN --frames --sideways --runs-read --results")
def film() -> None:
    """Draw the chain of a run at several times, and an animated GIF.

    Example:
      beads film yade:fig4-tube --sideways 10
    """


@command("run_commands", "RUN --frames --runs-read --results")
def vtk() -> None:
    """Write a run for ParaView (needs recorded positions).

    Example:
      beads vtk yade:fig4 --frames 200
    """


@command("draw_commands", "SCENE|RUN --set --measured --runs-read --results")
def overlay() -> None:
    """Draw measured traces over computed ones, with deviations.

    Examples:
      beads overlay example-measured
      beads overlay example-measured --set contact.restitution=0.9
      beads overlay yade:fig4 --measured shot-12.csv
    """


@command("report_commands", "QUOTED --free --law --predict --own --measured --quoted --set --quick --results --runs")
def fit() -> None:
    """Fit parameters of scenes to measured data.

    The data are the [[measured]] tables of the scenes, or those that --measured or --quoted name.

    Examples:
      beads fit example-measured --free contact.restitution
      beads fit shot.toml --law elastic --law power --free striker.speed=2±1%
    """


@command(
    "batch_commands",
    "STUDY --engine --only --runs --results --workers --dry-run --retry --yes --slice --dask "
    "--slurm --slices --slurm-line --wait",
)
def batch() -> None:
    """Run the missing cases of a study and write its table.

    Examples:
      beads batch sensitivity
      beads batch wall-material --engine verlet --workers 2 --dry-run
      beads batch sensitivity --slurm --wait
    """


@command("draw_commands", "STUDY --runs --results --x --y --log --power-law")
def study() -> None:
    """Draw the rows of a study, or two columns of its table.

    Examples:
      beads study sensitivity
      beads study speed-amplitude --x bead_5_amplitude --y speed_9_to_5 --log
    """


@command("batch_commands", "STUDY --engine --only --runs --list")
def status() -> None:
    """Count the rows of a study by state.

    Example:
      beads status sensitivity --list
    """


@command("batch_commands", "STUDY CASE --engine --runs")
def show() -> None:
    """Write one case of a study as run folders with their decks.

    Example:
      beads show wall-material 3 --engine lammps
    """


@command("run_commands", "ALL --set --engine --runs-read --prune --dry-run")
def runs() -> None:
    """List the run folders, or remove those that are obsolete.

    Examples:
      beads runs fig4 --engine yade
      beads runs --set 'striker.speed=*'
      beads runs --prune --dry-run
    """


@command("run_commands", "SCENE --set --engine --out --unsafe")
def render() -> None:
    """Write the deck of a scene for one engine, without running it.

    Example:
      beads render fig4 --engine liggghts --out deck
    """


@command("run_commands", "FOLDER --scene --set --engine --runs")
def import_() -> None:
    """Make a run folder of a deck that was run by hand.

    The deck may have been changed: the record names each line that differs from the scene's deck.

    Examples:
      beads import deck --engine liggghts
      beads import deck --engine yade --scene fig4 --set run.time_step='0.2 us'
    """


@command("report_commands", "PAPER --studies --out-file --engine --runs --require --allow-missing")
def report() -> None:
    """Write the report page and its checks as JSON.

    Examples:
      beads report
      beads report fig4 --out fig4.html --allow-missing
    """


@command("report_commands", "[NAME]... --runs --results", kind=_Figures)
def figures() -> None:
    """Make figures and the table of the paper, or of your own.

    Examples:
      beads figures
      beads figures fig4 table1
      beads figures my_figure.py
    """


@command("report_commands", "--file --runs --results", action="chapter")
def claims() -> None:
    """Judge the paper's statements, and engines by published numbers.

    Examples:
      beads claims
      beads claims --file my-cases.toml
    """


@command("report_commands", "--quick --budget --results", action="chapter")
def trade() -> None:
    """Measure error against cost for all engines and time steps.

    Examples:
      beads trade --quick
      beads trade --budget 600
    """


@command("report_commands", "--quick --runs --results", action="chapter")
def stability() -> None:
    """Measure stable steps, extreme scenes, long runs.

    Examples:
      beads stability
      beads stability --quick
    """


@command("report_commands", "--quick --runs --results", action="chapter")
def elements() -> None:
    """Measure effect and cost of each modelling element.

    Examples:
      beads elements
      beads elements --quick
    """


@command("report_commands", "--quick --results", action="chapter")
def calibration() -> None:
    """Fit parameters of each contact law to the paper's experiments.

    Examples:
      beads calibration
      beads calibration --quick
    """


@command("key_commands", "ENGINE --results")
def engine() -> None:
    """Test an adapter or a build of a code.

    Examples:
      beads engine verlet
      beads engine liggghts-old --engines mine.toml
    """


@command("key_commands", "", engines=False)
def wave() -> None:
    """Print constants of the discrete chain's solitary wave.

    Example:
      beads wave
    """


SECTIONS = {
    "a scene": [scenes, keys, plan, draw, modes, run, compare],
    "a run": [observables, spacetime, spectrum, energy, film, vtk],
    "measured data": [overlay, fit],
    "studies": [batch, study, status, show],
    "files of runs": [runs, render, import_],
    "report and paper": [report, figures, claims, trade, stability, elements, calibration],
    "engines": [engine, wave],
}
