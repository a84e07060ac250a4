"""Commands ``engine`` and ``wave``: tests of an adapter or a build, and the exact wave."""

import os
from pathlib import Path

import click

from drivers.base import paths
from drivers.base.errors import RunError
from validation.commands import completion, options
from validation.commands.options import command


@command("verlet", "liggghts-old --engines mine.toml")
@click.argument(
    "name",
    metavar="ENGINE",
    help="Name of an engine, such as verlet or an entry of your engines.toml.",
    shell_complete=completion.engines,
)
@options.RESULTS
def engine(name: str, results: Path) -> int:
    """Test an adapter or a build of a code."""
    from drivers.base.cache import store
    from drivers.engines import load_engine
    from drivers.run.build import build_of
    from validation.accuracy.costs import entry_of, kit_key, measured_cost

    tested = load_engine(name)
    if tested.find() is None:
        raise RunError(f"{name}: {tested.absence}")
    try:
        import pytest
    except ImportError as error:
        file = os.environ.get(paths.ENGINES_VARIABLE)
        command = f"make engine ENGINE={name}{f' ENGINES={file}' * bool(file)}"
        raise RunError(f"pytest is not installed; {command} installs it and runs this") from error
    arguments = ["-v", "-rs", "--tb=short", "--capture=sys"]  # lines on progress reach the screen
    arguments += ["--rootdir", str(paths.ROOT), "-c", str(paths.ROOT / "pyproject.toml")]
    if results != paths.RESULTS:
        arguments += ["--junitxml", str(results / f"engine-{name}.xml")]
    code = int(pytest.main([*arguments, "--engine", name, str(paths.ROOT / "validation/tests/engine")]))
    if code in (0, 1):  # else the tests did not end
        store(kit_key(name), code == 0)
    cost = measured_cost(tested, build_of(tested))
    where = f"as an entry of {paths.shown(paths.COSTS)}; for own engines no file has to be edited"
    print(f"\nmeasured cost, cached for plans and batches ({where}):\n" + "\n".join(entry_of(name, cost)))
    return int(code != 0)


@command("", engines=False)
def wave() -> None:
    """Print constants of the discrete chain's solitary wave."""
    from validation.reference.travelling_wave import constants, solve_travelling_wave

    print("\n".join(constants(solve_travelling_wave())))
