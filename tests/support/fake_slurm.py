"""``sbatch`` and ``scancel`` that run jobs here: installed into a folder of PATH."""

import sys

SBATCH = """#!{python}
import os, re, subprocess, sys
from pathlib import Path

tested = sys.argv[1] == "--test-only"
script, *arguments = sys.argv[1 + tested :]
text = Path(script).read_text()
assert text.startswith("#!"), "This does not look like a batch script"
if tested:
    sys.exit()
array = re.search(r"^#SBATCH --array=0-([0-9]+)", text, re.MULTILINE)
tasks = range(int(array[1]) + 1) if array else [None]
copy = Path({folder!r}) / f"job-{{os.getpid()}}.sh"  # as SLURM, which keeps its own
copy.write_text(text)
for task in tasks:
    extra = {{}} if task is None else {{
        "SLURM_ARRAY_TASK_ID": str(task), "SLURM_ARRAY_TASK_COUNT": str(len(tasks))
    }}
    started = subprocess.Popen(
        ["bash", str(copy), *arguments], env={{**os.environ, **extra}}, start_new_session=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )
    if task is not None:
        started.wait()
print("Submitted batch job", started.pid)
"""

SCANCEL = """#!{python}
import contextlib, os, signal, sys

for number in sys.argv[1:]:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(int(number), signal.SIGTERM)
"""


def install(folder):
    """Write both into a folder."""
    for name, text in {"sbatch": SBATCH, "scancel": SCANCEL}.items():
        path = folder / name
        path.write_text(text.format(python=sys.executable, folder=str(folder)))
        path.chmod(0o755)
