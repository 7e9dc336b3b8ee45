"""Every script says what it does and how it is set."""

import runpy
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
PARTS = {
    "benchmark": ["encoding", "tradeoff", "capacity", "photographs"],
    "profile_training": ["aerial2ground", "carff"],
}
CALLS = [(path.name, word) for path in sorted(SCRIPTS.glob("*.py")) for word in ["", *PARTS.get(path.stem, [])]]


@pytest.mark.parametrize(("script", "part"), CALLS)
def test_help_is_given(script, part, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [script, *([part] if part else []), "--help"])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(SCRIPTS / script), run_name="__main__")
    assert not end.value.code
    assert "--" in capsys.readouterr().out
