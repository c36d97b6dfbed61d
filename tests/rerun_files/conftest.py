"""What needs Rerun is collected where it is found: ``pip install 'omniscv[rerun]'``, half a gigabyte."""

from importlib.util import find_spec

collect_ignore = [] if find_spec("rerun") else ["test_rerun_file.py"]
