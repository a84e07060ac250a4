"""The commands by section, in the order in which a user meets them: help, examples, arguments, options."""

from pathlib import Path

import click

from drivers.base import paths
from postproc.figures import captions
from validation.commands.options import argument, command, file_to_write, instead, number, option


def _scenes(default: str) -> click.Argument:
    """Argument for any number of scenes; ``default`` says which are taken without it."""
    return argument("scenes", "[SCENE]...", f"Scenes by name or file (default: {default}).")


SCENE = argument("scene", "SCENE", "A scene file, or the name of a scene in inputs/scenes.")
STUDY = argument("study", "STUDY", "A study file, or the name of a study in inputs/studies.")
RUN = argument("run", "RUN", "A run folder, or ENGINE:SCENE for the newest run of that scene.")
SETTINGS = option(
    "--set settings KEY=VALUE ...",
    "A key of the scene with its value, such as chain.count=60 or run.time_step='10 ns'; an empty value removes "
    "the key; runs lists runs with this setting, where * is any text; repeatable.",
)
ENGINE = option(
    "--engine engines ENGINE ...",
    "Take this engine only; repeatable (default: all that are installed, or those of the study).",
)
REQUIRE = option("--require ENGINE ...", "Fail if this engine does not run; repeatable.")
ALLOW_MISSING = option(
    "--allow-missing", "Accept that engines of --engine, all codes or runs of --against are missing."
)
RUNS = option("--runs DIR", "Folder of the run folders (default: runs/ of the checkout).", default=lambda: paths.RUNS)
RUNS_READ = option("--runs DIR", str(RUNS.help), default=lambda: paths.RUNS, type=Path)  # may be read-only
RESULTS = option(
    "--results DIR", "Folder for tables and figures (default: results/ of the checkout).", default=lambda: paths.RESULTS
)
UNSAFE = option("--unsafe", "Accept a scene that a guard refuses, for instance a time step above the stability limit.")
MEASURED = option(
    "--measured FILE",
    "CSV file with forces in N, in columns named after gauges, such as bead_9 [N] (default: the [[measured]] "
    "tables of the scene, for any other file).",
)
FRAMES = option(
    "--frames N",
    "Number of times (default: 12 in a film, 100 for ParaView).",
    type=number(int, lambda count: 2 <= count <= 10_000, "whole numbers from 2 to 10000"),
)
QUICK = option(
    "--quick",
    "Do less: fewer scenes, steps and seeds, no long runs; for fit no profiles, no data left out, no runs of the "
    "codes.",
)
ONLY = option(
    "--only patterns PATTERN ...",
    "Take only cases with KEY=GLOB, such as 'striker.speed=2 m/s', or with a label that matches; repeatable "
    "(default: all cases).",
)
DRY_RUN = option("--dry-run", "Print what would be done, without doing it.")
JSON = option("--json as_json", "Print JSON.")
DASK = option(
    "--dask ADDRESS",
    "Run on the Dask cluster at ADDRESS; without ADDRESS, on a local Dask cluster.",
    is_flag=False,
    flag_value="local",
    default="",
)
EVERY = option(
    "--list every",
    "Print the state of each case: done, failed, timeout, refused, stale, claimed, to do, not installed.",
)
FREE = option(
    "--free KEY[=LOW..HIGH] ...",
    "Fit this key of the scene, such as contact.restitution=0.5..1, or with prior knowledge striker.speed=2±1%; "
    "repeatable (default bounds: inputs/calibration.toml).",
)
LAWS = option(
    "--law laws LAW ...",
    "Fit this contact law of inputs/calibration.toml (elastic, viscoelastic, power); repeatable: all on the same "
    "data, and compared.",
)
LEVELS = option(
    "--level levels X ...",
    "Measure widths at this share of the peak; repeatable (default: 0.002 and 0.04).",
    type=number(float, lambda share: 0 < share < 1, "a share of the peak, above 0 and below 1"),
)
PREDICT = option(
    "--predict OBSERVABLE ...",
    "Predict this observable, such as wall_peak or bead_8_reflected_arrival, with its error; repeatable.",
)
QUOTED = option(
    "--quoted SET,...",
    "Fit to data that the paper quotes: sets of inputs/calibration.toml, such as fig4,table1.",
    type=lambda text: tuple(name.strip() for name in text.split(",")) if text else (),
    default="",
)
RANGES = option(
    "--beads ranges A-B ...", "Energy of the bodies A to B, counted from the wall, the striker last; repeatable."
)
SCENES_OR_RUNS = argument(
    "what",
    "SCENE|RUN...",
    "Scenes by name or file, or exactly two runs: run folders, or ENGINE:SCENE for the newest run.",
    required=True,
)
SCENE_OF_DECK = option(
    "--scene SCENE",
    "Scene of the deck before changes, by name or file (default: the one that render wrote into FOLDER).",
)
SIDEWAYS = option(
    "--sideways X",
    "Multiply displacements from the axis by X (default: 1).",
    default=1.0,
    type=number(float, lambda factor: 0 < factor <= 1e6, "a factor above 0, up to 1e6"),
)
STUDIES = option(
    "--studies",
    "Write the page first, then make figures and studies and add them; short studies where no table exists.",
)
TABLE = argument(
    "table",
    "[TABLE]",
    "A table, such as chain.bead or axis, or a file: scene, study, engines (default: all files).",
    default="",
)


class _Figures(click.Command):
    """Command whose help lists the figures."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Figures"):
            formatter.write_dl([(name, caption.title) for name, caption in captions().items()])
        super().format_epilog(ctx, formatter)


@command("key_commands", engines=False)
def scenes() -> None:
    """List the shipped scenes, studies and materials."""


@command(
    "key_commands",
    TABLE,
    option("--markdown", "Print the tables in Markdown."),
    option("--write", "Write the tables of all files into inputs/README.md."),
    examples=["chain", "study --markdown"],
    engines=False,
)
def keys() -> None:
    """List keys of scenes and studies, with units and ranges."""


@command(
    "run_commands", SCENE, SETTINGS, ENGINE, examples=["fig4", "fig4 --set run.time_step= --set run.accuracy=1e-4"]
)
def plan() -> None:
    """Print time step, expected errors and cost of a scene."""


@command("draw_commands", SCENE, SETTINGS, RESULTS, examples=["fig4", "fig4 --set chain.count=5 --results drawings"])
def draw() -> None:
    """Draw a scene to scale."""


@command("draw_commands", SCENE, SETTINGS, RESULTS, examples=["steel-chain --set chain.precompression='10 N'", "dimer"])
def modes() -> None:
    """Draw linear modes of a scene, print bands and sound speed."""


@command(
    "run_commands",
    *(SCENE, SETTINGS, ENGINE, RUNS),
    option("--rerun", "Run again even if the run is done or, with auto, failed."),
    option("--time-limit SECONDS", "Stop a run after this time (default: by beads and steps)."),
    UNSAFE,
    examples=["fig4 --engine yade", "fig4 --engine auto", "fig4 --set chain.count=60 --set run.time_step='50 ns'"],
)
def run() -> None:
    """Run a scene and print the run folders.

    --engine auto takes the cheapest engine that models the scene, after those whose build or run failed the next
    one.
    """


@command(
    "run_commands",
    *(SCENES_OR_RUNS, SETTINGS, ENGINE, RUNS, REQUIRE, ALLOW_MISSING, UNSAFE),
    examples=["fig4", "fig4 --set run.time_step='1 us'", "yade:fig4 liggghts:fig4"],
)
def compare() -> None:
    """Run scenes and judge them on every engine, or compare runs."""


@command(
    "run_commands",
    *(RUN, RUNS_READ, LEVELS, JSON),
    instead("--definitions", "Print the definitions of all observables and exit.", "run_commands", "definitions"),
    examples=["yade:fig4", "yade:fig4 --level 0.1 --json"],
)
def observables() -> None:
    """Print peaks, speeds, widths, reflections, energies of a run."""


@command("draw_commands", RUN, RUNS_READ, RESULTS, examples=["yade:fig4"])
def spacetime() -> None:
    """Draw the force in every contact of a run against time."""


@command(
    "draw_commands",
    RUN,
    option("--from source SIGNAL", "Source of the transfer function: drive, or a gauge.", default=""),
    option("--to target SIGNAL", "Target of the transfer function: a gauge, such as wall.", default=""),
    option("--frequency F", "Measure harmonics of this frequency (default: that of a sine drive)."),
    option("--since TIME", "Begin of the record, such as '0.2 ms' (default: 0 s).", default="0 s"),
    option("--until TIME", "End of the record (default: that of the run)."),
    option("--window NAME", "hann (default), boxcar, blackmanharris or flattop.", default="hann"),
    *(JSON, RUNS_READ, RESULTS),
    examples=["yade:driven-steel", "yade:driven-steel --from bead_15 --to wall --since '0.2 ms'"],
)
def spectrum() -> None:
    """Draw spectra and a transfer function of the gauges of a run."""


@command(
    "draw_commands", RUN, RANGES, RUNS_READ, RESULTS, examples=["verlet:fig4", "verlet:fig4 --beads 1-5 --beads 6-21"]
)
def energy() -> None:
    """Draw the energy of each bead (needs recorded positions)."""


@command("draw_commands", RUN, FRAMES, SIDEWAYS, RUNS_READ, RESULTS, examples=["yade:fig4-tube --sideways 10"])
def film() -> None:
    """Draw the chain of a run at several times, and an animated GIF."""


@command("run_commands", RUN, FRAMES, RUNS_READ, RESULTS, examples=["yade:fig4 --frames 200"])
def vtk() -> None:
    """Write a run for ParaView (needs recorded positions)."""


@command(
    "draw_commands",
    argument("run", "SCENE|RUN", "A scene, for its exact motion; or a run folder, or ENGINE:SCENE."),
    *(SETTINGS, MEASURED, RUNS_READ, RESULTS),
    examples=["example-measured", "example-measured --set contact.restitution=0.9", "yade:fig4 --measured shot-12.csv"],
)
def overlay() -> None:
    """Draw measured traces over computed ones, with deviations."""


@command(
    "report_commands",
    *(_scenes("the scenes of --quoted"), FREE, LAWS, PREDICT),
    option("--own KEY[=LOW..HIGH] ...", "As --free, with a value of its own for each data set; repeatable."),
    *(MEASURED, QUOTED, SETTINGS, QUICK, RESULTS, RUNS),
    examples=[
        "example-measured --free contact.restitution",
        "shot.toml --law elastic --law power --free striker.speed=2±1%",
    ],
)
def fit() -> None:
    """Fit parameters of scenes to measured data.

    The data are the [[measured]] tables of the scenes, or those that --measured or --quoted name.
    """


@command(
    "batch_commands",
    *(STUDY, ENGINE, ONLY, RUNS, RESULTS),
    option("--workers N", "Number of processes on this machine (default: number of cores)."),
    DRY_RUN,
    option("--retry", "Run failed cases again."),
    option("--yes", "Accept a study of more than 20,000 cases."),
    option("--slice part I/N", "Run part I of N here, without writing the table."),
    DASK,
    option("--slurm", "Run as a Slurm job array."),
    option("--slices N", "Number of tasks of the job array (default: by the expected time)."),
    option("--slurm-line lines LINE ...", "Add a line to the job script, such as '#SBATCH --mem=2G'; repeatable."),
    option("--wait", "Wait for the job array, then write the table."),
    examples=["sensitivity", "wall-material --engine verlet --workers 2 --dry-run", "sensitivity --slurm --wait"],
)
def batch() -> None:
    """Run the missing cases of a study and write its table."""


@command(
    "draw_commands",
    *(STUDY, RUNS, RESULTS),
    option("--x COLUMN", "Draw --y against this column of the table.", default=""),
    option("--y COLUMN", "Column of numbers; a name may be without its unit.", default=""),
    option("--log", "Make the axes of --x and --y logarithmic."),
    option("--power-law", "Fit y = C x^n to each curve of each engine."),
    examples=["sensitivity", "speed-amplitude --x bead_5_amplitude --y speed_9_to_5 --log"],
)
def study() -> None:
    """Draw the rows of a study, or two columns of its table."""


@command("batch_commands", STUDY, ENGINE, ONLY, RUNS, EVERY, examples=["sensitivity --list"])
def status() -> None:
    """Count the rows of a study by state."""


@command(
    "batch_commands",
    STUDY,
    argument("case", "CASE", "Number of the case, as in the table of the study."),
    *(ENGINE, RUNS),
    examples=["wall-material 3 --engine lammps"],
)
def show() -> None:
    """Write one case of a study as run folders with their decks."""


@command(
    "run_commands",
    *(_scenes("all"), SETTINGS, ENGINE, RUNS_READ),
    option("--prune", "Remove runs that are not done, or whose build or deck is not today's."),
    DRY_RUN,
    examples=["fig4 --engine yade", "--set 'striker.speed=*'", "--prune --dry-run"],
)
def runs() -> None:
    """List the run folders, or remove those that are obsolete."""


@command(
    "run_commands",
    *(SCENE, SETTINGS, ENGINE),
    option("--out DIR", "Folder for the deck.", required=True),
    UNSAFE,
    examples=["fig4 --engine liggghts --out deck"],
)
def render() -> None:
    """Write the deck of a scene for one engine, without running it."""


@command(
    "run_commands",
    argument("folder", "FOLDER", "Folder with a deck that was run by hand, and its output."),
    *(SCENE_OF_DECK, SETTINGS, ENGINE, RUNS),
    examples=["deck --engine liggghts", "deck --engine yade --scene fig4 --set run.time_step='0.2 us'"],
    name="import",
)
def import_run_by_hand() -> None:
    """Make a run folder of a deck that was run by hand.

    The deck may have been changed: the record names each line that differs from the scene's deck.
    """


@command(
    "report_commands",
    *(_scenes("the paper's four"), STUDIES),
    option("--out FILE", "Page to write (default: results/report.html).", type=file_to_write),
    *(ENGINE, RUNS, REQUIRE, ALLOW_MISSING),
    examples=["", "fig4 --out fig4.html --allow-missing"],
)
def report() -> None:
    """Write the report page and its checks as JSON."""


@command(
    "report_commands",
    argument("names", "[NAME]...", "Figures (default: all)."),
    *(RUNS, RESULTS),
    examples=["", "fig4 table1"],
    kind=_Figures,
)
def figures() -> None:
    """Make figures and the table of the paper."""


@command(
    "report_commands",
    option("--file FILE", "Judge the cases of a file alone (default: all claims and inputs/independent.toml)."),
    *(RUNS, RESULTS),
    examples=["", "--file my-cases.toml"],
    action="chapter",
)
def claims() -> None:
    """Judge the paper's statements, and engines by published numbers."""


@command(
    "report_commands",
    QUICK,
    option("--budget budget_s SECONDS", "Engine time of all runs together (default: 300 s; 30 s with --quick)."),
    RESULTS,
    examples=["--quick", "--budget 600"],
    action="chapter",
)
def trade() -> None:
    """Measure error against cost for all engines and time steps."""


@command("report_commands", QUICK, RUNS, RESULTS, examples=["", "--quick"], action="chapter")
def stability() -> None:
    """Measure stable steps, extreme scenes, long runs."""


@command("report_commands", QUICK, RUNS, RESULTS, examples=["", "--quick"], action="chapter")
def elements() -> None:
    """Measure effect and cost of each modelling element."""


@command("report_commands", QUICK, RESULTS, examples=["", "--quick"], action="chapter")
def calibration() -> None:
    """Fit parameters of each contact law to the paper's experiments."""


@command(
    "key_commands",
    argument("name", "ENGINE", "Name of an engine, such as verlet or an entry of your engines.toml."),
    RESULTS,
    examples=["verlet", "liggghts-old --engines mine.toml"],
)
def engine() -> None:
    """Test an adapter or a build of a code."""


@command("key_commands", engines=False)
def wave() -> None:
    """Print constants of the discrete chain's solitary wave."""


SECTIONS = {
    "a scene": [scenes, keys, plan, draw, modes, run, compare],
    "a run": [observables, spacetime, spectrum, energy, film, vtk],
    "measured data": [overlay, fit],
    "studies": [batch, study, status, show],
    "files of runs": [runs, render, import_run_by_hand],
    "report and paper": [report, figures, claims, trade, stability, elements, calibration],
    "engines": [engine, wave],
}
