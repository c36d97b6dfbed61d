"""The processes of a cluster, forked from one that has imported all they need: to be killed.

Run as a program, it reads lines of JSON, an action of ``ACTIONS`` and its arguments, forks a process for
each, and prints its id. ``Cluster`` is how tests use it.
"""

import asyncio
import json
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from contextlib import suppress
from pathlib import Path

import psutil

PATIENCE_S = 30.0  # longer than anything takes on a busy machine


class Cluster:
    """Starts processes, and kills all that are left at the end; a context manager."""

    def __init__(self, folder):
        self._folder, self._pids, self._files = folder, set(), 0

    def __enter__(self):
        self._parent = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        return self

    def __exit__(self, *error):
        try:
            for pid in list(self._pids):
                with suppress(ProcessLookupError, psutil.NoSuchProcess):  # it has ended by itself
                    self.kill(pid)
        finally:
            self._parent.kill()
            self._parent.communicate()

    def start(self, action, *arguments):
        """Start an action; return its process, and the file that it writes when it is ready, or done."""
        self._files += 1
        report = self._folder / f"{action}-{self._files}.json"
        self._parent.stdin.write(json.dumps([action, str(report), *map(str, arguments)]) + "\n")
        self._parent.stdin.flush()
        pid = int(self._parent.stdout.readline())
        self._pids.add(pid)
        return pid, report

    def ready(self, action, *arguments):
        """Start an action, and wait for what it says; return its process and that."""
        pid, report = self.start(action, *arguments)
        return pid, waited_for(report)

    def kill(self, pid):
        """Kill a process, and what it has started, and wait until it has released its port."""
        process = psutil.Process(pid)
        os.killpg(pid, signal.SIGKILL)
        process.wait(PATIENCE_S)
        self._pids.discard(pid)


def waited_for(path):
    """Return what a process says."""
    until = time.monotonic() + PATIENCE_S
    while not path.exists():
        assert time.monotonic() < until, f"{path.stem} did not come"
        time.sleep(0.01)
    return json.loads(path.read_text())


# -- in the forked processes ---------------------------------------------------------------------------


def scheduler(report):
    """A scheduler of Dask; says its address."""

    async def run():
        import dask
        from distributed import Scheduler

        from omniscv.cluster.workers import SETTINGS

        with dask.config.set(SETTINGS):
            async with Scheduler(host="127.0.0.1", port=0, dashboard=False) as started:
                write_report(report, started.address)
                await started.finished()

    asyncio.run(run())


def worker(report, address, name):
    """A worker; says that it has started."""

    async def run():
        from distributed import Worker

        from omniscv.cluster.workers import RESOURCE

        until = time.monotonic() + PATIENCE_S
        while True:
            try:
                started = await Worker(address, nthreads=1, name=name, resources=RESOURCE, host="127.0.0.1")
                break
            except RuntimeError as refused:  # the name of a killed worker is free once its death is noticed
                if "name taken" not in str(refused.__cause__) or time.monotonic() > until:
                    raise
                await asyncio.sleep(0.1)
        write_report(report, started.address)
        await started.finished()

    asyncio.run(run())


def server(report, port):
    """A mock server at a port; says its address."""
    import mock_server

    with mock_server.serve("four-wall", int(port)) as started:
        write_report(report, started.uri)
        threading.Event().wait()


def make(report, job, address):
    """``dataset make JOB --cluster ADDRESS``; says what was made, or what is wrong."""
    from omniscv import cluster, jobs
    from omniscv.errors import OmniscvError

    try:
        made = cluster.make(jobs.load(Path(job)), cluster.workers_of(address))
        write_report(report, [made.written, made.kept])
    except OmniscvError as error:
        write_report(report, f"{type(error).__name__}: {error}")


def write_report(path, what):
    part = Path(f"{path}.part")
    part.write_text(json.dumps(what))
    part.replace(path)


ACTIONS = {each.__name__: each for each in (scheduler, worker, server, make)}


def main():
    import logging

    import distributed  # noqa: F401

    import mock_server  # noqa: F401
    import omniscv
    import omniscv.cluster
    import omniscv.sources.unreal.source

    logging.disable(logging.CRITICAL)  # of what is killed, Dask says much
    camera = omniscv.cameras.create("equirectangular", width=32, height=16)
    with omniscv.open_source("scene://four-wall") as source:  # loads the kernels
        omniscv.render(camera, omniscv.Pose.from_angles((0, 0, 1.5)), source, ("lit",), face_size=16)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the dead are not waited for
    for line in sys.stdin:
        action, *arguments = json.loads(line)
        pid = os.fork()
        if pid == 0:
            os.setpgid(0, 0)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            try:
                ACTIONS[action](*arguments)
            except BaseException:
                traceback.print_exc()
            os._exit(0)
        print(pid, flush=True)


if __name__ == "__main__":
    main()
