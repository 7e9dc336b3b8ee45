"""The header of a report."""

import platform
import subprocess

import torch

from hashnerf.run_info import commit, machine, processor, run_info_now


def test_the_header_names_run_machine_and_versions():
    info = run_info_now("mine", "fast", "intersection", "python scripts/x.py --name 'a b'", 7)
    assert (info.name, info.seed, info.scenario, info.preset) == ("mine", 7, "intersection", "fast")
    assert f"torch {torch.__version__.split('+')[0]}" in info.versions
    assert platform.python_version() in info.versions
    assert "cores" in machine() and f"{torch.get_num_threads()} threads used" in info.machine


def test_the_processor_is_read_from_cpuinfo(tmp_path):
    path = tmp_path / "cpuinfo"
    path.write_text("processor\t: 0\nmodel name\t: Some CPU: fast\nmodel name\t: Other\n")
    assert processor(path) == "Some CPU: fast"
    assert processor(tmp_path / "missing") == (platform.processor() or platform.machine())


def test_the_commit_says_when_files_differ_from_it(tmp_path):
    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=n", "-c", "user.email=e@example.org", "-c", "commit.gpgsign=false"]
        subprocess.run(["git", *identity, *arguments], cwd=tmp_path, check=True, capture_output=True)

    assert commit(tmp_path) == "unknown"
    git("init")
    assert commit(tmp_path) == "unknown", "no commit yet"
    (tmp_path / "a").write_text("1")
    git("add", "a")
    git("commit", "-m", "one")
    head = commit(tmp_path)
    assert len(head) == 12 and int(head, 16) >= 0
    (tmp_path / "a").write_text("2")
    assert commit(tmp_path) == f"{head} with changes"
