"""A dask cluster does the work of the pool: the same bits, whatever dies on the way."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import pytest
from batch_results import Said, contents, plain
from mortal_work import DieOnce, Environment, Squares

from host_sync.batch.cluster import Unfinished, _Job, _unfit, computing_versions, connected, outcomes_on_cluster
from host_sync.batch.library_batch import ReconstructionOptions, one_by_one, reconstruct_on_cluster
from host_sync.batch.worker_pool import ONE_THREAD
from host_sync.cli.main import main
from host_sync.errors import ClusterError
from host_sync.library.library import Library
from host_sync.reconstruction.scans import LibraryReconstructor

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

WITHOUT = "dask is not installed: pip install 'retrograph[cluster]'"

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
"""Of sockets that dask's own cluster leaves to the garbage collector."""


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    """Two workers with a thread each."""
    distributed = pytest.importorskip("distributed", reason=WITHOUT)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        yield cluster


@pytest.fixture(scope="module")
def client(cluster: LocalCluster) -> Iterator[Client]:
    with connected(cluster.scheduler_address) as client:
        yield client


def begun(folder: Path) -> Counter[int]:
    return Counter(int(line) for line in (folder / "begun").read_text().split())


def test_the_task_of_a_killed_worker_is_done_by_another(client: Client, tmp_path: Path) -> None:
    found = list(outcomes_on_cluster(client, range(6), Squares(tmp_path, deadly=(0, 4)), tmp_path))
    assert sorted(found) == [(number, number * number) for number in range(6)]
    times = begun(tmp_path)
    assert set(times) == set(range(6))
    assert times[0] >= 2
    assert times[4] >= 2


def test_a_task_that_kills_every_worker_is_given_up_and_the_rest_is_done(client: Client, tmp_path: Path) -> None:
    found = dict(outcomes_on_cluster(client, range(4), Squares(tmp_path, fatal=(3,)), tmp_path))
    lost = found.pop(3)
    assert isinstance(lost, Unfinished)
    assert "died 4 times (at last tcp://" in lost.reason
    assert found == {0: 0, 1: 1, 2: 4}


def test_no_more_tasks_leave_than_workers_have_room_for(client: Client, tmp_path: Path) -> None:
    client.wait_for_workers(2)
    asked: list[int] = []

    def tasks() -> Iterator[int]:
        for number in range(9):
            asked.append(number)
            yield number

    for done, _ in enumerate(outcomes_on_cluster(client, tasks(), Squares(tmp_path), tmp_path)):
        assert len(asked) <= done + 2


def test_every_worker_computes_with_one_thread(client: Client, tmp_path: Path) -> None:
    names = [name for name in ONE_THREAD if name != "NUMBA_NUM_THREADS"]  # which is set in the process
    assert dict(outcomes_on_cluster(client, names, Environment(), tmp_path)) == dict.fromkeys(names, "1")


@pytest.mark.slow
def test_a_cluster_gives_the_bits_of_one_process_though_a_worker_is_killed_in_mid_scan(
    client: Client, library: Library, tmp_path: Path
) -> None:
    alone, shared = Library(tmp_path / "alone"), Library(tmp_path / "shared")
    for copy in (alone, shared):
        shutil.copytree(library.root, copy.root)
    expected = list(one_by_one(alone.scans().bundles, LibraryReconstructor(alone)))
    scans = shared.scans().bundles
    work = ReconstructionOptions(shared.root, report_progress=DieOnce(tmp_path / "died", "results"))
    found = list(reconstruct_on_cluster(scans, work, LibraryReconstructor(shared), client))
    assert (tmp_path / "died").exists()
    assert Counter(one.scan for one in found) == Counter(scan.scan_id for scan in scans)
    assert plain(found, shared) == plain(expected, alone)
    assert contents(shared) == contents(alone)
    assert [path for path in shared.root.iterdir() if path.name.startswith(".retrosync-")] == []


def test_the_command_line_gives_a_library_to_a_scheduler_of_a_file(
    cluster: LocalCluster, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    held = Library(tmp_path / "scans")
    shutil.copytree(library.root, held.root)
    named = tmp_path / "scheduler.json"
    named.write_bytes(msgspec.json.encode(cluster.scheduler.identity(), enc_hook=str))
    assert main(["reconstruct", "--library", str(held.root), "--cluster", str(named), "--json"]) == 1
    said = msgspec.json.decode(capsys.readouterr().out, type=Said, dec_hook=lambda kind, text: kind(text))
    assert [one.reason is None for one in said.scans] == [True, True, False]


def test_workers_with_several_threads_are_refused(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason=WITHOUT)
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=":0") as cluster,
        connected(cluster.scheduler_address) as client,
        pytest.raises(ClusterError, match="has 2 threads: start it with `dask worker --nthreads 1`"),
    ):
        next(outcomes_on_cluster(client, [1], Squares(tmp_path), tmp_path))


def test_a_cluster_that_loses_all_workers_ends_in_a_sentence(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason=WITHOUT)
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as cluster,
        connected(cluster.scheduler_address) as client,
    ):
        outcomes = outcomes_on_cluster(client, range(3), Squares(tmp_path), tmp_path, no_worker_s=0.5)
        assert next(outcomes) == (0, 0)
        cluster.scale(0)
        with pytest.raises(ClusterError, match=r"had no worker for 0\.5 s"):
            list(outcomes)


def test_a_scheduler_without_workers_is_refused() -> None:
    distributed = pytest.importorskip("distributed", reason=WITHOUT)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0") as cluster,
        pytest.raises(ClusterError, match="has no workers: start some with"),
        connected(cluster.scheduler_address, answer_s=0.5),
    ):
        pass


@pytest.mark.parametrize("place", ["tcp://127.0.0.1:9", "nonsense://"])
def test_a_scheduler_that_does_not_answer_is_refused(place: str) -> None:
    pytest.importorskip("distributed", reason=WITHOUT)
    with pytest.raises(ClusterError, match=f"scheduler of {place} does not answer"), connected(place, answer_s=0.5):
        pass


def test_a_worker_that_is_unlike_this_computer_says_so(tmp_path: Path) -> None:
    place = tmp_path / "library" / ".retrosync-1"
    job = _Job(Environment(), place, computing_versions(), "a")
    assert "does not see" in (_unfit(job) or "")
    place.mkdir(parents=True)
    assert _unfit(job) is None
    older = replace(job, versions=(("numpy", "1.0"),))
    assert (_unfit(older) or "").endswith("not 1.0: install the same versions everywhere")
    if os.geteuid() != 0:
        place.parent.chmod(0o500)
        assert "may not write" in (_unfit(job) or "")


def test_a_file_that_is_missing_and_other_options_are_refused(
    library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    held = ["reconstruct", "--library", str(library.root), "--cluster", str(tmp_path / "absent")]
    assert main([*held, "--workers", "2"]) == 2
    assert "--cluster is for the scans of a library" in capsys.readouterr().err
    assert main(held) == 2
    said = capsys.readouterr().err
    assert "neither an address" in said or "pip install 'retrograph[cluster]'" in said
    assert len(said.splitlines()) == 1
