"""Every field of every record refuses what its declaration does not allow, in one line with its key."""

import importlib
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import omniscv
from omniscv import arguments
from omniscv.errors import ArgumentError
from omniscv.records import key_of, read, reader_of

ROOT = Path(omniscv.__file__).parent


def records():
    """Yield the records of all modules but those that need PyTorch."""
    for path in sorted(ROOT.rglob("*.py")):
        inside = path.relative_to(ROOT).with_suffix("").parts
        if "torch" in inside or inside == ("records",) or "@record" not in path.read_text(encoding="utf-8"):
            continue
        module = importlib.import_module(".".join(("omniscv", *inside)))
        for each in vars(module).values():
            if is_dataclass(each) and isinstance(each, type) and each.__module__ == module.__name__:
                yield each


RECORDS = {f"{each.__module__}.{each.__name__}": each for each in records()}


class Strange:
    """Nothing that a field takes."""

    def __repr__(self):
        return "strange\nthing " * 100


def beyond(function, limits):
    """Values that a reader of arguments.py has to refuse, by its limits."""
    yield Strange()
    if function in (arguments.number, arguments.optional_number):
        yield from (np.nan, np.inf, True, "much", [1])
        yield from (limits[key] for key in ("above", "below") if key in limits)
        yield from (np.nextafter(limits["least"], -np.inf) for _ in range("least" in limits))
        yield from (np.nextafter(limits["most"], np.inf) for _ in range("most" in limits))
    elif function is arguments.whole_number:
        yield from (1.5, True, "1", None, limits.get("least", 1) - 1)
        yield from (most + 1 for most in [limits.get("most")] if most is not None)
    elif function is arguments.numbers:
        shape = [size or 3 for size in limits["shape"]]
        yield from (np.full(shape, np.nan).tolist(), "abc", None, {}, [])
        yield from (np.zeros([shape[0] + 1, *shape[1:]]).tolist() for _ in range(None not in limits["shape"]))
    elif function is arguments.one_of:
        yield from ("no such word", "", None, 1, [*limits["words"]])
    elif function is arguments.flag:
        yield from (1, "yes", None)
    elif function in (arguments.text, arguments.label):
        yield from ("", "a\0b", 3, None, ["a"])
    elif function is arguments.texts:
        yield from ([], "a", [1], [""])


every_record = pytest.mark.parametrize("name", RECORDS)


@every_record
def test_fields_refuse_what_they_do_not_declare(name):
    for field in fields(RECORDS[name]):
        key = key_of(field)
        reader = reader_of(field)
        function, limits = (reader.func, reader.keywords) if isinstance(reader, partial) else (reader, {})
        for value in beyond(function, limits) if reader else ():
            with pytest.raises(ArgumentError) as refused:
                reader(key, value)
            line = str(refused.value)
            assert line.startswith(key)
            assert "expected" in line
            assert "\n" not in line
            assert len(line) <= 1000


@every_record
def test_keys_that_records_do_not_have_are_refused(name):
    for value, says in (({"no_such_key": 1}, "unknown key 'no_such_key'; known "), (3, "expected a mapping")):
        with pytest.raises(ArgumentError, match=f"^there: {says}"):
            read(RECORDS[name], value, "there")
