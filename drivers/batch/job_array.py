"""Slices of a study as a Slurm job array."""

import os
import re
import shlex
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from math import ceil
from pathlib import Path

from drivers.base import paths
from drivers.base.decks import render
from drivers.base.errors import RunError
from drivers.batch.rows import MAX_CHUNK, Batch, expected_s
from drivers.batch.store import Store
from drivers.chain.case import Case
from drivers.chain.schemes import default_limit_s
from drivers.engines import load_engine

MAX_ARRAY_SIZE = 1001  # Slurm's default
SECONDS_PER_TASK = 60.0  # shorter tasks are dominated by the scheduler
POLL_INTERVAL_S = 2.0
MAX_FAILURES = 30  # of squeue in a row
FOLDER = ".slurm"  # in the runs folder
MARGIN = 3.0  # of the time limit of a task over its expected time; machines differ
LEAST_TIME_S = 600.0  # of a task: its start from a network file system may take minutes
LEAST_BYTES, BYTES_PER_VALUE = 0.75e9, 300.0  # memory of a task, and for each body and sample: measured 0.4e9, 160
OUTPUT = "{study}-{job}_{task}.txt"


def most_tasks() -> int:
    """Largest number of tasks that this site allows in a job array; Slurm's default if ``scontrol`` does not say."""
    size = re.search(r"^MaxArraySize\s*=\s*(\d+)", subprocess.getoutput("scontrol show config"), re.MULTILINE)
    return max(1, (int(size[1]) if size else MAX_ARRAY_SIZE) - 1)  # indices begin at 0, tasks at 1


def job_script(
    batch: Batch, store: Store, sample: Sequence[Case], slices: int | None, lines: Sequence[str]
) -> tuple[Path, str, int]:
    """File and text of the script of a job array for the slices with unfinished cases, and the number of its tasks.

    Lines with #SBATCH come before all commands, as Slurm requires, and replace the limits of memory and time. The
    folders of the programs of engines that are installed here are added to the PATH of the login profile.

    Args:
        batch: the batch.
        store: store of the rows, for the unfinished ones and the expected time.
        sample: some cases of the study, for their size.
        slices: number of tasks; None for one by the expected time.
        lines: lines of the script before its command.
    """
    study, todo = batch.study, batch.todo(store)
    expected = expected_s(batch, store, todo, sample)
    unfinished, rows = set().union(*todo.values()) or {*batch.numbers}, sum(map(len, todo.values()))
    wanted = ceil(len(batch.numbers) / MAX_CHUNK if expected is None else expected / SECONDS_PER_TASK)
    parts, most = max(1, min(slices or wanted, len(batch.numbers))), most_tasks()
    if parts > most:
        print(f"{parts} tasks cut to {most}, the limit of job arrays here (MaxArraySize)")
        parts = most
    row_limit_s = study.file.limit or max(map(default_limit_s, sample))
    counts = Counter(1 + place % parts for place, number in enumerate(batch.numbers) if number in unfinished)
    limit_s = (row_limit_s * rows if expected is None else MARGIN * expected) * max(counts.values()) / len(unfinished)
    memory_bytes = LEAST_BYTES + BYTES_PER_VALUE * max(case.chain.bodies * case.scene.samples for case in sample)
    command = [str(Path(sys.executable).with_name("beads")), "batch", str(study.path)]
    command += ["--runs", str(batch.runs.resolve())]
    command += [word for name in batch.engines for word in ("--engine", name)]
    command += [word for pattern in batch.patterns for word in ("--only", pattern)]
    command += ["--retry"] if batch.retry else []
    folder = (batch.runs / FOLDER).resolve()
    codes = [name for name in batch.here if not load_engine(name).in_repository]
    programs = [Path(word).parent for name in codes for word in batch.builds[name].command if "/" in word]
    text = render(
        "slurm/job.sh.j2",
        batch=batch,
        cases=f"{len(unfinished)} case{'s' * (len(unfinished) > 1)}",
        name=shlex.quote(f"beads-{study.name}"),
        array=f"1-{parts}" if len(counts) == parts else ",".join(map(str, sorted(counts))),
        output=shlex.quote(str(folder / OUTPUT.format(study=study.name, job="%A", task="%a"))),
        minutes=ceil(max(limit_s, LEAST_TIME_S) / 60),
        megabytes=ceil(memory_bytes / 1e8) * 100,
        lines=lines,
        programs=[shlex.quote(str(place)) for place in dict.fromkeys(programs)],
        variable=paths.ENGINES_VARIABLE,
        entries=shlex.quote(os.pathsep.join(map(str, batch.entries))),
        root=shlex.quote(str(paths.ROOT)),
        command=shlex.join(command),
        parts=parts,
    )
    return folder / f"{study.name}.sh", text, len(counts)


def print_job(path: Path, text: str, tasks: int) -> None:
    """Print the script of a job array that is not submitted."""
    print(f"\n{text}\nsbatch --parsable {shlex.quote(str(path))}")
    print(f"job array of {tasks} task{'s' * (tasks != 1)} with one worker each; nothing submitted")


def run_job(path: Path, text: str, _: int) -> Iterator[None]:
    """Submit the script of a job array, and yield repeatedly until all its tasks have ended.

    Raises:
        RunError: sbatch refused the script, or squeue does not answer.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    done = subprocess.run(["sbatch", "--parsable", str(path)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RunError(f"sbatch refused {paths.shown(path)}: {done.stderr.strip() or done.stdout.strip()}")
    job, failures = done.stdout.strip().partition(";")[0], 0
    output = path.with_name(OUTPUT.format(study=path.stem, job=job, task="*"))
    print(f"job {job}: {paths.shown(path)}, output in {paths.shown(output)}", flush=True)
    yield
    while failures < MAX_FAILURES:
        command = ["squeue", "--noheader", "--jobs", job, "--format=%T"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if (done.returncode == 0 and not done.stdout.strip()) or "Invalid job id" in done.stderr:
            return  # ended; Slurm may have forgotten the job
        failures = failures + 1 if done.returncode else 0
        time.sleep(POLL_INTERVAL_S)
        yield
    raise RunError(f"job {job}: squeue does not answer: {done.stderr.strip()}")
