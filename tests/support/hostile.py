"""What hostile servers answer with, whatever they were asked."""

MILLION = "9" * 1_000_000
REPLIES = {
    "nothing": "ok",
    "an error": "error " + "\x1b[31m" * 50_000,
    "no UTF-8": b"\xff\xfe" + b"x" * 1000,
    "a million digits": MILLION,
    "a number of a million digits": f"FOV: {MILLION}\n",
    "a colour of a million digits": f"(R={MILLION},G=0,B=0,A=255)",
    "no numbers": "nan inf -inf nan nan nan",
    "one that is none": "nan",
    "large numbers": "1e300 1e300 1e300 1e300 1e300 1e300",
    "a large number": "1e300",
    "a negative number": "-90",
    "many words": "x " * 100_000,
    "a long word": "x" * 100_000,
    "what controls terminals": "\x1b]0;title\x07\x1b[2J [bold] \u202e \x9b",
    "a null": "a\0b",
    "a picture cut short": b"\x89PNG\r\n\x1a\n" + b"\xff" * 40,
    "an array": b"\x93NUMPY\1\0\x76\0{'descr': '<f4', 'fortran_order': False, 'shape': (999999999, 1), }",
}
