"""Folders to import, spoiled: an index, tables and images that are not what they should be."""

import contextlib
import json
import os
import shutil

from attack.commands import nothing_left, ran, require
from attack.samples import contents, same, sample
from attack.texts import scrambled
from attack.words import JSON_TEXTS, JSON_VALUES


def replaced(rng, value):
    """A JSON value with something in it replaced, removed or added."""
    if not isinstance(value, dict | list) or not value or rng.random() < 0.1:
        return rng.choice(JSON_VALUES)
    if isinstance(value, list):
        index = rng.randrange(len(value))
        return [
            *value[:index],
            *rng.choice([[], [replaced(rng, value[index])], [value[index]] * 2]),
            *value[index + 1 :],
        ]
    key = rng.choice(list(value))
    rest = {each: value[each] for each in value if each != key}
    return rng.choice(
        [
            rest,
            {**rest, key: replaced(rng, value[key])},
            {**rest, key: replaced(rng, value[key])},
            {**value, "also": rng.choice(JSON_VALUES)},
        ]
    )


def spoil(rng, folder):
    """Change a file of the folder."""
    files = sorted(each for each in folder.iterdir() if each.is_file() and not each.is_symlink())
    path = rng.choice([*[each for each in files if each.suffix == ".json"] * 8, *files])
    kind = rng.randrange(10)
    if kind == 0:
        path.unlink()
    elif kind == 1:
        path.unlink()
        rng.choice(
            [
                path.mkdir,
                lambda: path.symlink_to("/dev/zero"),
                lambda: path.symlink_to(path.name),
                lambda: os.link(files[0], path) if files[0] != path else path.touch(),
            ]
        )()
    elif path.suffix == ".json":
        text = path.read_bytes().decode(errors="replace")
        if kind == 8:
            text = rng.choice(JSON_TEXTS)
        elif kind == 9:
            text = scrambled(rng, text)
        else:
            with contextlib.suppress(ValueError, RecursionError):  # spoiled before
                text = json.dumps(replaced(rng, json.loads(text)))
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
    else:
        data = bytearray(path.read_bytes())
        for _ in range(rng.choice([1, 5])):
            data[rng.randrange(len(data))] = rng.randrange(256)
        path.write_bytes(data[: rng.choice([len(data), rng.randrange(len(data))])])


def case(rng, folder):
    """A spoiled folder is refused and changes nothing, or becomes a recording that verifies."""
    true = sample()
    with nothing_left(folder) as work:
        shutil.copytree(true.folder, work / "faces")
        for _ in range(rng.choice([1, 1, 2, 3])):
            spoil(rng, work / "faces")
        target = work / "room.sqlite"
        if resumed := rng.random() < 0.5:
            shutil.copy(true.recording, target)
        outcome = ran(["recording", "import", "faces", target.name])
        if outcome.code == 0:
            verified = ran(["recording", "check", target.name])
            require(verified.code == 0, f"imported, and does not verify: {verified.out}{verified.err}")
            ran(["recording", "info", target.name])
        elif resumed:
            captures, objects = contents(target)
            require(same(captures, objects), "a refused import changed the recording")
        else:
            left = sorted(each.name for each in work.iterdir())
            require(left == ["faces"], f"a refused import left {left}")
