"""Runs the notebooks, and the examples of the documentation and the README."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import matplotlib
import matplotlib.pyplot
import numpy as np
import pytest
import soundfile

from conftest import ROOT, data_folder, gear_signal

matplotlib.use("Agg")
NOTEBOOKS = sorted((ROOT / "python/notebooks").glob("*.py"))


def run_notebook(notebook: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(notebook.parent)
    runpy.run_path(str(notebook), run_name="__main__")
    matplotlib.pyplot.close("all")


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(notebook, service, monkeypatch, capsys):
    """With the real recordings if there are any."""
    monkeypatch.setenv("FLANKWATCH_URL", service[0])
    folder = data_folder()
    monkeypatch.setenv("FLANKWATCH_DATA", str(folder))
    run_notebook(notebook, monkeypatch)
    if notebook.stem == "real_gearbox":
        expected = "recording: " if folder.is_dir() else "there is no recording "
        assert capsys.readouterr().out.startswith(expected)


def test_the_gearbox_notebook_says_that_it_simulates(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("FLANKWATCH_DATA", str(tmp_path))
    run_notebook(ROOT / "python/notebooks/real_gearbox.py", monkeypatch)
    assert capsys.readouterr().out.startswith(f"there is no recording {tmp_path}")


def examples(path: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", path.read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("document", ["docs/python.md", "README.md"])
def test_examples_run(document, service, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recordings = service[1] / "recordings"
    recordings.mkdir(exist_ok=True)
    soundfile.write(recordings / "run.wav", gear_signal(4).astype(np.float32), 20_000, subtype="FLOAT")
    names: dict[str, object] = {"url": service[0]}
    found = examples(ROOT / document)
    assert found
    for number, example in enumerate(found, 1):
        exec(compile(example, f"{document}, example {number}", "exec"), names)
