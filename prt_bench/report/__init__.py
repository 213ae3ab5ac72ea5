"""Tables, plots and answers derived from `records.jsonl` alone: no model is fitted, rendered or timed here."""

from prt_bench.report.html import write_report
from prt_bench.report.leaderboard import write_leaderboard

__all__ = ["write_leaderboard", "write_report"]
