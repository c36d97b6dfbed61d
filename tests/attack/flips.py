"""One bit of a recording flipped: it is refused, or nothing that was recorded has changed."""

from attack.commands import clear, nothing_left, ran, require
from attack.samples import contents, same, sample
from omniscv.errors import OmniscvError


def case(rng, folder):
    """Flip one bit anywhere, and replay everything."""
    data = bytearray(sample().recording.read_bytes())
    bit = rng.randrange(8 * len(data))
    data[bit // 8] ^= 1 << bit % 8
    with nothing_left(folder) as work:
        (work / "room.sqlite").write_bytes(data)
        try:
            found = contents(work / "room.sqlite")
        except OmniscvError as error:
            clear(error)
            require(ran(["recording", "check", "room.sqlite"]).code, f"bit {bit} is refused, and not found")
        else:
            require(same(*found), f"other data than was recorded, with bit {bit} flipped")
