"""Files and folders of the checkout."""

from pathlib import Path

from drivers.base.errors import printable

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("drivers", "postproc", "validation")
INPUTS = ROOT / "inputs"
SCENES = INPUTS / "scenes"
STUDIES = INPUTS / "studies"
MATERIALS = INPUTS / "materials.toml"
ENGINES = INPUTS / "engines.toml"
COSTS = INPUTS / "costs.toml"
ELEMENTS = INPUTS / "elements.toml"
INDEPENDENT = INPUTS / "independent.toml"
CALIBRATION = INPUTS / "calibration.toml"
QUOTED = INPUTS / "paper" / "quoted.toml"
CALIBRATED = INPUTS / "paper" / "calibrated.toml"
CLAIMS = INPUTS / "paper" / "claims.toml"
TEMPLATES = ROOT / "templates"
RUNS = ROOT / "runs"
RESULTS = ROOT / "results"
CACHE = ROOT / ".cache"  # may be deleted at any time
ENGINES_VARIABLE = "BEAD_CHAINS_ENGINES"  # set by --engines, read by all child processes


def shown(path: Path) -> str:
    """Path for a message, relative to the present folder if it lies below."""
    try:
        return printable(str(path.resolve().relative_to(Path.cwd())), lines=False)
    except (ValueError, OSError, RuntimeError):  # not below the present folder, or a loop of links
        return printable(str(path), lines=False)
