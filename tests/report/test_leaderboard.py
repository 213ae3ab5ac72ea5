"""Ranks, ties, and the four forms of the leaderboard."""

import csv
import io
import json
import shutil
import subprocess
from dataclasses import asdict

import pytest
from rich.console import Console

from prt_bench import records as record_files
from prt_bench.errors import DatasetError
from prt_bench.report import console
from prt_bench.report.frontier import METRICS
from prt_bench.report.leaderboard import figure, flatten, to_csv, to_json, to_latex, to_markdown, write_leaderboard
from prt_bench.report.ranking import groups

NASTY = 'a|b & 50% of_#1 {x} ~^\\ "q", <b>, [z]\nnext = Ω é'


@pytest.mark.parametrize(
    ("metric", "value", "text"),
    [
        ("relative_rmse", 0.0190000001, "0.0190"),
        ("relative_rmse", 1.234e-5, "1.23e-05"),
        ("relative_rmse", 0.0, "0"),
        ("psnr", 41.26, "41.3"),
        ("fit_s", 99.96, "100"),
        ("fit_s", 12345.6, "12346"),
        ("asset_bytes", 999, "999 B"),
        ("asset_bytes", 1_500_000, "1.50 MB"),
        ("frame_ms", None, "–"),
    ],
)
def test_figures_have_three_digits(metric, value, text):
    assert figure(metric, value) == text


def test_csv_parsed_back_equals_the_records(records, make_record):
    records = [*records, make_record(label=NASTY, scene='a,b\n"c"')]
    lines = list(csv.DictReader(io.StringIO(to_csv(groups(records)))))
    assert len(lines) == len(records)
    by_key = {(line["scene"], line["split"], line["label"]): line for line in lines}
    for record in records:
        line = by_key[record.scene, record.split, record.label]
        for name, value in flatten(record).items():
            if value is None:
                assert line[name] == ""
            elif isinstance(value, bool):
                assert line[name] == str(value)
            else:
                assert type(value)(line[name]) == value, name


def test_csv_holds_every_error_and_stage(make_record):
    record = make_record()
    (line,) = csv.DictReader(io.StringIO(to_csv(groups([record]))))
    for name, value in asdict(record.errors).items():
        assert float(line[f"errors.{name}"]) == value
    for timing in record.timings:
        for name, stage in timing.stages.items():
            assert float(line[f"{timing.api}.{name}.median"]) == stage.median
            assert float(line[f"{timing.api}.{name}.iqr"]) == stage.iqr
    assert line["rank"] == "1"


def test_json_keeps_ranks_figures_and_failures(records):
    board = json.loads(to_json(groups(records)))
    assert [(g["scene"], g["split"]) for g in board["groups"]] == [
        ("cornell", "test"), ("cornell", "ood-environment"), ("suzanne", "test"), ("suzanne", "ood-environment"),
    ]  # fmt: skip
    for group in board["groups"]:
        ranks = [entry["rank"] for entry in group["entries"] if entry["rank"] is not None]
        assert ranks == sorted(ranks)
        failed = next(entry for entry in group["entries"] if entry["label"] == "mlp-large")
        assert failed["status"] == "timeout"
        assert failed["rank"] is None
        assert failed["metrics"]["frame_ms"] is None
    assert board["metrics"]["psnr"]["better"] == "higher"
    assert set(board["metrics"]) == set(METRICS)


def test_markdown_survives_nasty_names(make_record):
    text = to_markdown(groups([make_record(label=NASTY), make_record()]))
    table = [line for line in text.splitlines() if line.startswith("|")]
    bars = {line.replace("\\|", "").count("|") for line in table}
    assert len(table) == 4
    assert len(bars) == 1, "every row has the same cells"
    assert "<b>" not in text


def test_failed_rows_and_their_reasons_are_shown(records):
    text = to_markdown(groups(records))
    assert text.count("timeout: the fit took over 60 s") == 4
    assert text.count("oracle: needs the reference at run time") == 4


def test_latex_is_ascii_and_escaped(make_record):
    text = to_latex(groups([make_record(label=NASTY, scene="[x]")]))
    assert text.isascii()
    assert r"50\% of\_\#1 \{x\} \textasciitilde{}\textasciicircum{}\textbackslash{}" in text
    body = [line for line in text.splitlines() if line.endswith(r"\\")]
    columns = {line.replace(r"\&", "").count("&") for line in body}
    assert len(columns) == 1


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
def test_latex_compiles(tmp_path, records, make_record):
    table = to_latex(groups([*records, make_record(label=NASTY, scene="[x]", scenario="*y")]))
    (tmp_path / "leaderboard.tex").write_text(table, encoding="utf-8")
    (tmp_path / "paper.tex").write_text(
        r"\documentclass{article}\usepackage{booktabs}\begin{document}\input{leaderboard}\end{document}",
        encoding="utf-8",
    )
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"],
        cwd=tmp_path,
        capture_output=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stdout.decode(errors="replace")[-2000:]


def test_files_are_written_whole(run_dir):
    paths = write_leaderboard(run_dir)
    assert [path.name for path in paths] == [f"leaderboard.{suffix}" for suffix in ("md", "csv", "json", "tex")]
    assert all(path.stat().st_size > 1000 for path in paths)
    assert not list(run_dir.glob(".leaderboard*"))


def test_missing_records_are_one_sentence(tmp_path):
    with pytest.raises(DatasetError, match="no records"):
        write_leaderboard(tmp_path)


@pytest.mark.parametrize("width", [80, 160])
def test_console_shows_every_row_with_its_place(records, width):
    terminal = Console(width=width, record=True, file=io.StringIO())
    terminal.print(console.leaderboard(records))
    text = terminal.export_text()
    assert text.count("svd-ridge b64") == text.count("mlp-large") == 4
    assert "timeout" in text
    assert "1=" in text


def test_console_takes_markup_in_names_literally(make_record):
    terminal = Console(width=160, record=True, file=io.StringIO())
    terminal.print(console.leaderboard([make_record(label="[red]x[/red]", scene="[/bold]")]))
    text = terminal.export_text()
    assert "[red]x[/red]" in text
    assert "[/bold]" in text


def test_records_survive_their_file(tmp_path, records):
    for record in records:
        record_files.append(tmp_path / "records.jsonl", record)
    read = record_files.read(tmp_path / "records.jsonl")
    assert to_csv(groups(read)) == to_csv(groups(records))
