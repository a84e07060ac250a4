"""What is asked for of a study: some of its engines and cases, and a slice of these."""

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from drivers.base.errors import InputError
from drivers.batch.study import Study


@dataclass(frozen=True)
class Selection:
    """Engines in the order of the study, and numbers of cases.

    Attributes:
        patterns: by which the cases were chosen.
    """

    engines: tuple[str, ...]
    numbers: Sequence[int]
    patterns: tuple[str, ...]

    def slice_of(self, part: int, parts: int) -> Sequence[int]:
        """The cases of a part, counted from 1: every so many-th, so that parts cost about the same."""
        return self.numbers[part - 1 :: parts]


def select(study: Study, engines: Sequence[str], patterns: Sequence[str]) -> Selection:
    """The engines and cases that are asked for; without engines or patterns all of them.

    A pattern is ``KEY=GLOB`` on the value that the study has there, or a glob on the case's whole label. Patterns of
    one key add up, different keys narrow down.

    Raises:
        InputError: an engine that the study does not have, or no case that matches.
    """
    for name in engines:
        if name not in study.engines:
            raise InputError("--engine", "", f'"{name}"', f"the engines of the study: {', '.join(study.engines)}")
    by_key: dict[str, list[str]] = {}
    for pattern in patterns:
        key, _, value = pattern.partition("=")
        known = key in study.columns
        by_key.setdefault(key if known else "", []).append(value if known else pattern)
    numbers: Sequence[int] = range(1, study.count + 1)
    for key, globs in by_key.items():
        numbers = [number for number in numbers if _matches(study, number, key, globs)]
    if not numbers:
        labels = "; ".join(study.label(number) for number in range(1, min(study.count, 3) + 1))
        raise InputError(f"--only {' --only '.join(patterns)}", "", "no case", f"patterns of labels such as {labels}")
    chosen = tuple(name for name in study.engines if name in engines or not engines)
    return Selection(chosen, numbers, tuple(patterns))


def _matches(study: Study, number: int, key: str, globs: list[str]) -> bool:
    text = study.label(number)
    if key:
        text = str(study.choice(number).get(study.columns[key], ""))
    return any(fnmatchcase(text, glob) for glob in globs)
