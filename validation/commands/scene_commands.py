"""Commands on scenes: ``scenes``, ``plan``, ``draw``, ``render``."""

from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.terminal import text_table
from validation.commands import options
from validation.commands.options import checked, command, must_be_folder, one_of, option, print_paths


@command("", engines=False)
def scenes() -> None:
    """List the shipped scenes, studies and materials."""
    from drivers.scene.read_scene import read_toml

    listed = {
        what: {path.stem: read_toml(path).get("title", "") for path in sorted(home.glob("*.toml"))}
        for what, home in (("scenes", paths.SCENES), ("studies", paths.STUDIES))
    }
    listed["materials"] = {name: material.get("source", "") for name, material in read_toml(paths.MATERIALS).items()}
    for what, texts in listed.items():
        print(f"{what}:", *(f"  {line}" for line in text_table(texts.items())), sep="\n")


@command("fig4", "fig4 --set run.time_step= --set run.accuracy=1e-4")
@options.SCENE
@options.SETTINGS
@options.ENGINE
def plan(scene: str, settings: tuple[str, ...], engines: tuple[str, ...]) -> None:
    """Print time step, expected errors and cost of a scene."""
    from drivers.engines import load_engine
    from validation.accuracy.plan_report import plan_report

    for name in engines:
        load_engine(name, "--engine")
    for line in plan_report(scene, settings, engines):
        print(line)


@command("fig4", "fig4 --set chain.count=5 --results drawings")
@options.SCENE
@options.SETTINGS
@options.RESULTS
def draw(scene: str, settings: tuple[str, ...], results: Path) -> None:
    """Draw a scene to scale."""
    from postproc.draw.product import Product, write_product
    from postproc.draw.scene_drawing import draw_scene
    from validation.accuracy.plan import planned_case

    case = planned_case(scene, *settings)
    product = Product(*draw_scene(case.scene, case.chain))
    print_paths(write_product(product, f"scene-{case.scene.name}", results))


@command("steel-chain --set chain.precompression='10 N'", "dimer")
@options.SCENE
@options.SETTINGS
@options.RESULTS
def modes(scene: str, settings: tuple[str, ...], results: Path) -> None:
    """Draw linear modes of a scene, print bands and sound speed."""
    from postproc.draw.product import write_product
    from postproc.linear.modes import MAX_BEADS
    from postproc.linear.modes_figure import modes_product
    from validation.accuracy.plan import planned_case

    case = planned_case(scene, *settings)
    beads = case.chain.beads
    if not 0 < beads <= MAX_BEADS:
        raise InputError(case.scene.file, "chain.count", f"{beads}", f"from 1 to {MAX_BEADS} beads for modes")
    try:
        product = modes_product(case)
    except ValueError as error:
        print(f"{case.scene.name}: {error}")
        return
    for line in product.notes:
        print(line)
    print_paths(write_product(product, f"modes-{case.scene.name}", results))


@command("fig4 --engine liggghts --out deck")
@options.SCENE
@options.SETTINGS
@options.ENGINE
@option("--out", "DIR", "Folder for the deck.", type=Path, required=True, callback=checked(must_be_folder))
@options.UNSAFE
def render(scene: str, settings: tuple[str, ...], engines: tuple[str, ...], out: Path, unsafe: bool) -> None:
    """Write the deck of a scene for one engine, without running it."""
    from drivers.engines import load_engine
    from drivers.limits import refuse
    from drivers.run.run_folder import write_scene
    from validation.accuracy.plan import planned_case

    engine = load_engine(one_of(engines), "--engine")
    case = planned_case(scene, *settings)
    if not unsafe:
        refuse(case, engine.name)
    deck = engine.by_hand(engine.render(case))
    out.mkdir(parents=True, exist_ok=True)
    write_scene(out, case.scene)
    for file in deck.write(out):
        print(file)
