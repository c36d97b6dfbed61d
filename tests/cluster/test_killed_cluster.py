"""Kill -9 of a worker, a server and the scheduler: what is left goes on to the same bytes."""

import time

from support.clusters import PATIENCE_S, Cluster, waited_for
from support.datasets import tree

from omniscv import dataset, jobs

JOB = """
source: {source}
source_options: {{patience_s: 30}}
cameras:
  pano: {{model: equirectangular, width: 32, height: 16}}
  lens: {{model: fisheye-equidistant, width: 24, height: 24, fov_deg: 180}}
poses:
  path: {{waypoints: [[-1.2, 0, 1.5], [1.2, 0.3, 1.5]], speed: 1, rate: {rate}, look: ahead}}
modes: [lit, object_mask, depth]
face_size: 16
out: {out}
"""


def job_of(folder, out, source, rate):
    path = folder / f"{out}.yaml"
    path.write_text(JOB.format(source=source, out=out, rate=rate), encoding="utf-8")
    return path


def frames_in(out, count):
    """Wait until so many frames are whole."""
    until = time.monotonic() + PATIENCE_S
    while len([path for path in out.glob("*-*.json") if not path.name.startswith(".")]) < count:
        assert time.monotonic() < until
        time.sleep(0.005)


def test_killed_workers_servers_and_schedulers(tmp_path):
    with Cluster(tmp_path) as cluster:
        games = [cluster.ready("server", 0) for _ in range(2)]
        addresses = [address for _, address in games]
        source = f"[{', '.join(addresses)}]"
        jobs.make(jobs.load(job_of(tmp_path, "single", addresses[0], 6)))
        wanted = tree(tmp_path / "single")
        job, out = job_of(tmp_path, "killed", source, 6), tmp_path / "killed"
        boss, address = cluster.ready("scheduler")
        workers = [cluster.ready("worker", address, number)[0] for number in range(2)]
        _, said = cluster.start("make", job, address)
        frames_in(out, 2)
        cluster.kill(workers[0])
        cluster.ready("worker", address, 0)
        frames_in(out, 8)
        cluster.kill(games[1][0])  # whose worker is busy, with its own part or with that of the dead one
        cluster.ready("server", addresses[1].rpartition(":")[2])
        frames_in(out, 14)
        cluster.kill(boss)
        lost = waited_for(said)
        assert "ClusterError: expected the scheduler to stay" in lost
        assert "run the same command again" in lost
        _, address = cluster.ready("scheduler")
        for number in range(2):
            cluster.ready("worker", address, number)
        written, kept = cluster.ready("make", job, address)[1]
        assert written + kept == len(jobs.load(job))
        assert kept >= 14
        assert tree(out) == wanted
        assert cluster.ready("make", job, address)[1] == [0, written + kept]
        assert tree(out) == wanted
    assert dataset.check(out, deep=True) == []
