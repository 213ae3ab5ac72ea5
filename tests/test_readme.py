"""What the README shows works as written."""

import re
from pathlib import Path

import pytest

from prt_bench.cli import main

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SMALL = {
    "lightings=128": "lightings=4",
    "texels=128": "texels=32",
    "rays=256": "rays=16",
    "measurements=256": "measurements=32",
}


def test_the_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    for setting, smaller in SMALL.items():
        assert setting in example
        example = example.replace(setting, smaller).replace("basis=16", "basis=4")
    monkeypatch.setenv("PRT_BENCH_DATA", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(example, "README.md", "exec"), names)
    assert names["prediction"].shape == names["relit"].indirect.shape
    assert (tmp_path / "cornell-operator-ridge" / "manifest.json").is_file()


def test_its_commands_exist(capsys: pytest.CaptureFixture[str]):
    lines = re.findall(r"^prt-bench (.*?)(?:  .*)?$", README, re.MULTILINE)
    commands = {usage.split()[0] for line in lines for usage in line.split(" | ")}
    assert {"run", "plan", "fit", "evaluate", "best", "doctor"} <= commands
    for command in commands:
        with pytest.raises(SystemExit, match="0"):
            main([command, "--help"])
    with pytest.raises(SystemExit, match="2"):
        main(["no-such-command", "--help"])


def test_its_links_lead_somewhere():
    links = re.findall(r"\]\(([^)#]+)\)", README)
    assert links
    assert not [link for link in links if "://" not in link and not (ROOT / link).exists()]
