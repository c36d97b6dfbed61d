"""File systems that refuse locks, as Lustre and NFS may: a library before the C library, for a process."""

import os
import subprocess

import pytest

_SHIM = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdlib.h>

int flock(int fd, int how) { (void)fd; (void)how; errno = atoi(getenv("REFUSED_FLOCK")); return -1; }

static int control(const char *name, int fd, int command, void *argument) {
  const char *refused = getenv("REFUSED_FCNTL");
  if (refused && (command == F_SETLK || command == F_SETLKW || command == F_OFD_SETLK)) {
    errno = atoi(refused);
    return -1;
  }
  return ((int (*)(int, int, ...))dlsym(RTLD_NEXT, name))(fd, command, argument);
}

int fcntl(int fd, int command, ...) {
  va_list list; va_start(list, command); void *argument = va_arg(list, void *); va_end(list);
  return control("fcntl", fd, command, argument);
}

int fcntl64(int fd, int command, ...) {
  va_list list; va_start(list, command); void *argument = va_arg(list, void *); va_end(list);
  return control("fcntl64", fd, command, argument);
}
"""


def without_locks(folder, flock, fcntl=None):
    """The environment of a process whose ``flock``, and ``fcntl`` if given, fail with numbers of errors."""
    library = folder / "refused.so"
    try:
        subprocess.run(
            ["gcc", "-shared", "-fPIC", "-x", "c", "-", "-o", library, "-ldl"],
            input=_SHIM, text=True, check=True, capture_output=True, timeout=60,
        )  # fmt: skip
    except FileNotFoundError:
        pytest.skip("needs gcc")
    numbers = {"REFUSED_FLOCK": str(flock)} | ({} if fcntl is None else {"REFUSED_FCNTL": str(fcntl)})
    return {**os.environ, "LD_PRELOAD": str(library), **numbers}
