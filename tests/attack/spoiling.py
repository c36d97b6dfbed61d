"""Changes to files, JSON and texts that were right."""

import contextlib
import json
import os
import shutil

from attack.words import JSON_TEXTS, JSON_VALUES, SIGNS, YAML


def write(path, text):
    """Write a text, whatever characters it has; return the path."""
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return path


def regular_files(folder):
    """Return the files of a folder that are no links, sorted."""
    return sorted(path for path in folder.iterdir() if path.is_file() and not path.is_symlink())


def replaced(rng, value, other=lambda rng, value: rng.choice(JSON_VALUES)):
    """A value of JSON or YAML in which something is removed, added, or ``other`` in its place."""
    if not isinstance(value, dict | list) or not value or rng.random() < 0.1:
        return other(rng, value)
    if isinstance(value, list):
        index = rng.randrange(len(value))
        changed = rng.choice([[], [replaced(rng, value[index], other)], [value[index]] * 2])
        return [*value[:index], *changed, *value[index + 1 :]]
    key = rng.choice(list(value))
    rest = {each: value[each] for each in value if each != key}
    changed = {**rest, key: replaced(rng, value[key], other)}
    return rng.choice([rest, changed, changed, {**value, "also": other(rng, value)}])


def scrambled(rng, text):
    """A text with some characters or pieces replaced, removed, repeated or cut."""
    for _ in range(rng.randint(1, 4)):
        start = rng.randrange(len(text) + 1)
        end = min(len(text), start + rng.choice([0, 1, 1, 3, 20]))
        piece = rng.choice([rng.choice(SIGNS), rng.choice(YAML), text[start:end] * 3, ""])
        text = text[:start] + piece + text[end:]
    return text[: rng.randrange(len(text) + 1)] if rng.random() < 0.1 else text


def text_changed(rng, text):
    """JSON with a value replaced, another text, or characters exchanged."""
    kind = rng.randrange(8)
    if kind == 0:
        return rng.choice(JSON_TEXTS)
    if kind == 1:
        return scrambled(rng, text)
    with contextlib.suppress(ValueError, RecursionError):  # spoiled before
        return json.dumps(replaced(rng, json.loads(text)))
    return text


def bytes_changed(rng, data):
    data = bytearray(data)
    for _ in range(rng.choice([0, 1, 1, 5]) if data else 0):
        data[rng.randrange(len(data))] = rng.randrange(256)
    cut = rng.choice([len(data), rng.randrange(len(data) + 1)])
    more = rng.choice([b"", b"", b"x" * 99])
    return bytes(data[:cut]) + more


def strange(rng, path):
    """Put something else in the place of a file."""
    others = [other for other in path.parent.iterdir() if other != path and other.is_file()]
    path.unlink()
    target = rng.choice(["/dev/zero", path.name, rng.choice(others)])
    rng.choice(
        [
            lambda: None,
            path.mkdir,
            lambda: os.mkfifo(path),
            *[lambda: path.symlink_to(target)] * 3,
            lambda: shutil.copy(rng.choice(others), path),
            lambda: (path.touch(), os.truncate(path, 64 << 30)),
            path.touch,
        ]
    )()


def head(path, most=1 << 24):
    """The first bytes of a file, which an earlier change may have made 64 GiB long."""
    with path.open("rb") as file:
        return file.read(most)


def spoil_file(rng, path):
    """Put something else in the place of a file, or change its JSON or its bytes."""
    if rng.random() < 0.2:
        strange(rng, path)
    elif path.suffix == ".json":
        write(path, text_changed(rng, head(path).decode(errors="replace")))
    else:
        path.write_bytes(bytes_changed(rng, head(path)))
