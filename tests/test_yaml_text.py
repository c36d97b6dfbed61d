"""YAML of others: plain values, or one line within a second."""

import json
import time
from functools import partial

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from mock_server import yaml_text
from omniscv.errors import ArgumentError
from omniscv.storage import bounded


def laughs(width, depth):
    """Lists of aliases of lists of aliases: a few bytes that stand for ``width ** depth`` texts."""
    rows = [f"a0: &a0 [{', '.join(['x'] * width)}]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * width)}]" for i in range(1, depth)]
    return "\n".join(rows)


HOSTILE = {
    "laughs": (laughs(9, 12), "at most 100000 values, aliases expanded"),
    "deep": ("[" * 100_000, "at most 32 levels|nesting depth"),  # newer PyYAML counts, too
    "deep-mappings": ("{a: " * 100_000, "at most 32 levels"),
    "deep-blocks": ("- " * 100_000, "at most 32 levels"),
    "deep-by-alias": ("a: &a " + "[" * 20 + "]" * 20 + "\nb: " + "[" * 20 + "*a" + "]" * 20, "32 levels"),
    "itself": ("&a [*a]", "at most 32 levels"),
    "digits": ("a: " + "9" * 1_000_000, "numbers of at most 64 characters"),
    "nearly-digits": ("[" + "9" * 1_000_000 + "x", "expected YAML"),
    "many": ("[" + "1," * 100_001 + "]", "at most 100000 values"),
    "tag": ("a: !!timestamp x", "no tags"),
    "python": ("!!python/object/apply:os.system [exit]", "no tags"),
    "twice": ("a: 1\nb: 2\na: 3", "every key once"),
    "no-key": ("? {a: 1}\n: 2", "keys that are plain texts"),
    "documents": ("--- 1\n--- 2", "one document"),
    "control": ("a: \x1b[31m", "expected YAML"),
    "open": ("{", "expected YAML"),
    "unknown-alias": ("a: 1\nb: *c", "line 2: expected one document, got: found undefined alias"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_text_is_one_short_line_within_a_second(name):
    text, says = HOSTILE[name]
    started = time.process_time()
    with pytest.raises(ArgumentError, match=says) as refused:
        bounded.parse_yaml(text)
    assert time.process_time() - started < 5  # a hang guard: it takes 0.3 s at most
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) <= 300


PLAIN = {
    "": None,
    "a: {b: [1, -2.5, .5, 1., 1e3, +7]}": {"a": {"b": [1, -2.5, 0.5, 1.0, 1000.0, 7]}},
    "[true, False, null, ~, '', \"1\"]": [True, False, None, None, "", "1"],
    "[.inf, -.INF]": [float("inf"), float("-inf")],
    "[2001-01-01, 1:30, yes, 0x10, 1_000, 1e, .]": ["2001-01-01", "1:30", "yes", "0x10", "1_000", "1e", "."],
    "a: &x {b: 1}\nc: [*x, *x]": {"a": {"b": 1}, "c": [{"b": 1}, {"b": 1}]},
    "1: x\ntrue: y": {"1": "x", "true": "y"},
    "a: |\n  one\n  two\n": {"a": "one\ntwo\n"},
}


@pytest.mark.parametrize("text", PLAIN)
def test_plain_values(text):
    assert bounded.parse_yaml(text) == PLAIN[text]


# Not like a number: YAML 1.1 writes the text 1e3 without quotes.
TEXTS = st.text(st.characters(exclude_categories=["C", "Zl", "Zp"]), max_size=12).map("x".__add__)
NUMBERS = st.integers(-(10**15), 10**15) | st.floats(allow_nan=False, allow_infinity=False)
VALUES = st.recursive(
    st.none() | st.booleans() | NUMBERS | TEXTS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=4),
)


@pytest.mark.parametrize("write", [partial(json.dumps, ensure_ascii=False), yaml.safe_dump])
@cases(30)
@given(value=VALUES)
def test_what_other_programs_write_is_read(write, value):
    assert bounded.parse_yaml(write(value)) == value


def test_a_file_that_is_no_text_is_refused_and_a_mark_of_utf_8_is_not_part_of_it(tmp_path):
    path = tmp_path / "file"
    with pytest.raises(ArgumentError, match="No such file"):
        bounded.read_text(path)
    too_long = b"x" * (1 + yaml_text.MOST_BYTES)
    for content, says in ((too_long, "at most 1048576 bytes"), (b"\xff\xfe", "not UTF-8")):
        path.write_bytes(content)
        with pytest.raises(ArgumentError, match=says):
            bounded.read_text(path)
    path.write_bytes("\ufeffa: 1".encode())
    assert bounded.read_text(path) == "a: 1"
