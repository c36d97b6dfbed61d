"""Values that attacks put in the place of right ones: in YAML, JSON, SQL and command lines."""

DIGITS = "9" * 1_000_000
LAUGHS = (
    "[&a [1, 1], "
    + ", ".join(f"&{y} [{', '.join([f'*{x}'] * 9)}]" for x, y in zip("abcde", "bcdef", strict=True))
    + "]"
)
"""Eleven lines that stand for a hundred thousand values."""

# fmt: off
YAML = [
    "", "~", "true", "yes", "-1", "0", "1", "-0", "1.5", "7", "64", "1e9", "1e400", "-1e400", "1e-320",
    ".nan", ".inf", "-.inf", "nan", "inf", "1_000", "0x10", "0o7", "1:30", "2001-01-01", "2001-99-99",
    "2001-01-01T00:00:00Z", "'1'", "''", "'x'", "[]", "{}", "[[]]", "[1]", "[1, 2, 3]", "[1, 2, x]",
    "[.nan, 0, 0]", "[1e308, 1e308, -1e308]", "[[[[[[1]]]]]]", "{a: 1}", "{1: 2}", "{a: 1, a: 2}",
    "!!timestamp x", "!!timestamp 2001-01-01", "!!python/object/apply:os.system [exit]", "!!binary x",
    "!!float x", "!!int x", "!!set {a}", "!!str 1", "! 1", "!x 1", "*a", "&a [*a]", "&a 1", "<<: 1",
    "{<<: {a: 1}}", "|", "?", "-", "@", "`", "%", "'", '"', "[", "{", "#", '"\\x1b[31m[/b]"', '"[/b]"',
    '"\\u202e\\u200b"', '"a\\0b"', '"\\ud83d"', '"\\n\\r"', "é", "😀", "٣", "²", "..", ".", "/", "../up",
    "a/b", "~root", "auto", "lit", "depth", "[lit, lit]", "[lit, [depth]]", "cube", "exact", "pinhole",
    "equirectangular", "png", "jpg", "mock://", "mock://moon", "mock://four-wall?size=0x0",
    "mock://four-wall?size=1000000x1000000", "mock://four-wall?latency_ms=inf", "mock://four-wall?fault=x",
    "scene://", "scene://moon", "scene://four-wall?lit=x", "launch:", "unreal://[::1", "unreal://:x",
    "unreal://a:99999999", "unreal+unix://", "http://x", "x:y", "localhost:9000", "4294967296",
    "18446744073709551616", "1000000", "1000001", "-9223372036854775809", DIGITS, "'" + DIGITS + "'",
    "0." + DIGITS, "1e" + "9" * 5000, "x" * 100_000, '"' + "\\x1b" * 1000 + '"', "[" * 200_000,
    "{a: " * 1000, "[" + "1," * 300_000 + "]", LAUGHS, "[" + "[1, 2], " * 5000 + "]",
    "{" + ", ".join(f"k{i}: {i}" for i in range(2000)) + "}",
]
SIGNS = [
    "\x00", "\x07", "\x1b", "\t", "\n", "\r", " ", ":", "-", ",", "[", "]", "{", "}", "&", "*", "!", "|",
    "'", '"', "%", "\\", "\u2028", "\u202e", "\ufeff", "9", "e", ".",
]
ARGUMENTS = [
    *(each for each in YAML if len(each) <= 100_000 and "\0" not in each), "9" * 100_000, "8x4", "0x0",
    "1000000x1000000", "16384x8193", "9" * 5000 + "x1", "8x", "x", "８x４", "0,0,1.5", "0,0", "nan,0,0",
    "0,0,1e308", "radius=1", "radius=" + "9" * 5000, "k=0.1,0.2,0,0", "name=x", "model=pinhole", "width=3",
    "=", "a=[",
    "face_size=9", "strategy=guess", "camera.radius=1", "truth=1", "source_options.timeout_s=-1",
    "self=1", "fov_deg=!!timestamp x", "focal=1e308", "center=nan,nan", "lit,mask", "lit,,",
    "0.5px", "px", "info", "verify", "--help", "-h", "--", "-", "\udcff", "[/b]", "[bold", "\x1b[31m",
    "\u202e", "unreal://127.0.0.1:1/x?y", "mock://four-wall?dialect=0.3.10", "scene://waves",
    "noncentral-panorama", "/dev/null", "/dev/zero", "/", ".",
]
SQL = [
    "NULL", "''", "'x'", "x'00'", "0", "-1", "9e999", "9223372036854775807", "'[]'", "'{}'", "'{'", "'null'",
    "'png'", "'depth'", "'../x'", "'\x1b[31m[/b]'", "CAST('é' AS BLOB)", "randomblob(100)",
    "zeroblob(1000000)", "printf('%.*c', 5000, '[')", "printf('%.*c', 5000, '9')",
]
JSON_VALUES = [
    None, True, -1, 0, 8.0, 2**63, float("nan"), float("inf"), "", "x", "../x", "/etc/passwd", "\x1b[31m[/b]",
    "\u202e", "a\0b", "9" * 10000, "lit", "depth", "png", "npy", [], [1], [[]] * 100, {}, {"a": 1},
]
JSON_TEXTS = [
    "", "[", "null", "[]", "{}", "NaN", "[" * 100_000, "9" * 100_000, '{"a": 1, "a": 2}', '"\\ud800"',
    "\ufeff[]", "[1e999]",
]
