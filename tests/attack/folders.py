"""Folders to import, spoiled: an index, tables and images that are not what they should be."""

import shutil

from attack.commands import nothing_left, ran, require
from attack.samples import contents, same, sample
from attack.spoiling import regular_files, spoil_file


def case(rng, folder):
    """A spoiled folder is refused and changes nothing, or becomes a recording that verifies."""
    true = sample()
    with nothing_left(folder) as work:
        shutil.copytree(true.folder, work / "faces")
        for _ in range(rng.choice([1, 1, 2, 3])):
            files = regular_files(work / "faces")
            spoil_file(rng, rng.choice([*[file for file in files if file.suffix == ".json"] * 8, *files]))
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
