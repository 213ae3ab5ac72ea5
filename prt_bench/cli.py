"""The `prt-bench` command. Every mistake a user can mend ends in one sentence on standard error and exit status 2."""

import argparse
import errno
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

import prt_bench as prt
from prt_bench.assets import DTYPES
from prt_bench.errors import PrtBenchError, RuntimeUnavailable, SpecError

_REMEDIES = {
    errno.ENOSPC: "free some space and run the same command again",
    errno.EACCES: "choose a place that you may write to",
    errno.EPERM: "choose a place that you may write to",
    errno.EROFS: "choose a place that can be written to",
    errno.EEXIST: "choose another place, or move what is there",
    errno.ENOTDIR: "choose a place inside a folder",
}
_out = Console(width=None if sys.stdout.isatty() else 140)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    args = _parser().parse_args(arguments)
    try:
        return args.run(args) or 0
    except PrtBenchError as error:
        print(f"prt-bench: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        if error.errno not in _REMEDIES:
            raise
        where = f"{error.filename}: " if error.filename else ""
        print(f"prt-bench: {where}{error.strerror}; {_REMEDIES[error.errno]}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("prt-bench: interrupted; run the same command again to go on from here", file=sys.stderr)
        return 130
    return 0


def _run(args: argparse.Namespace) -> None:
    from prt_bench.records import read
    from prt_bench.report.console import leaderboard
    from prt_bench.run import run

    folder = run(args.spec, args.out)
    _out.print(leaderboard(read(folder / "records.jsonl")))
    _out.print(f"report: {folder / 'report.html'}", highlight=False, soft_wrap=True)


def _plan(args: argparse.Namespace) -> None:
    print(prt.plan(prt.load_scene(args.scene), args.scenario, **_bake_settings(args)).table())


def _bake(args: argparse.Namespace) -> None:
    from data_gen.cost import comparison

    ds = prt.bake(
        prt.load_scene(args.scene),
        args.scenario,
        seed=args.seed,
        out=args.out,
        workers=args.workers,
        **_bake_settings(args),
    )
    print(f"{ds.path}\nhash {ds.hash}\nnoise floor {ds.split('test').noise_floor:.2%} (test)")
    print(f"{sum(ds.metadata['seconds'].values()):.1f} s, {ds.metadata['rays']} rays, {ds.metadata['bounces']} bounces")
    if "actual" in ds.metadata:  # datasets of older versions have none
        print(comparison(ds.metadata["predicted"], ds.metadata["actual"]))


def _fit(args: argparse.Namespace) -> None:
    ds = prt.LightingDataset.open(args.dataset)
    model = prt.method(args.method, **_settings(args.set)).fit(ds.split("train"))
    asset = model.export(args.out, args.storage)
    print(f"{asset.path}: {sum(asset.bytes.values())} bytes, sha256 {asset.sha256}")


def _evaluate(args: argparse.Namespace) -> None:
    asset = prt.load_asset(args.asset)
    record = prt.evaluate(asset, prt.LightingDataset.open(args.dataset).split(args.split))
    for name, value in asdict(record.errors).items():
        if value is not None:
            print(f"{name:<16} {value:.6g}")


def _time(args: argparse.Namespace) -> None:
    from prt_bench.frames import time_assets
    from prt_bench.runtime.runtime import Runtime
    from prt_bench.spec import TimeSpec

    ds = prt.LightingDataset.open(args.dataset)
    assets = {str(path): prt.load_asset(path) for path in args.assets}
    spec, loaded = TimeSpec(rounds=args.rounds), {}
    try:
        runtime = Runtime(ds, spec.size, spec.shadow_resolution)
        loaded = {path: runtime.load(asset) for path, asset in assets.items()}
    except RuntimeUnavailable as error:
        print(f"prt-bench: {error}; timing JAX alone", file=sys.stderr)
    for path, timings in time_assets(ds, assets, loaded, spec).items():
        for timing in timings:
            print(f"{path}  {timing.api} on {timing.device} ({timing.clock} clock)")
            for stage, figure in timing.stages.items():
                print(f"  {stage:<12} {figure.median:10.4f} ms  IQR {figure.iqr:.4f}  over {figure.rounds} rounds")


def _view(args: argparse.Namespace) -> None:
    from prt_bench.runtime.runtime import Runtime

    try:
        from prt_bench.runtime.viewer import view
    except ImportError as error:
        raise RuntimeUnavailable(f"the viewer needs Tk ({error}); on Debian: apt-get install python3-tk") from error
    ds = prt.LightingDataset.open(args.dataset)
    runtime = Runtime(ds)
    maps = [prt.Lighting((prt.EnvironmentLight(path),)) for path in args.environment]
    lightings = (*maps, *ds.split("test").lightings)
    view(runtime, lightings, runtime.load(prt.load_asset(args.asset)), ds.scene.camera)


def _report(args: argparse.Namespace) -> None:
    from prt_bench.report import write_leaderboard, write_report

    write_leaderboard(args.folder)
    print(write_report(args.folder))


def _compare(args: argparse.Namespace) -> None:
    from prt_bench.report.query import compare_table

    _out.print(compare_table(args.records, args.a, args.b))


def _best(args: argparse.Namespace) -> None:
    from prt_bench.report.query import best_table

    _out.print(best_table(args.records, args.within))


def _scenes(_: argparse.Namespace) -> None:
    from data_gen.scenes import summary

    for name in prt.scenes():
        print(f"{name:<14} {summary(name)}")


def _assets(args: argparse.Namespace) -> None:
    from data_gen.fetch import LICENCE, MESHES, PACKAGE, fetch

    for name, fetched in fetch(args.names).items():
        mesh = MESHES[name]
        state = "fetched" if fetched else "here already"
        print(f"{name:<10} {state}: {mesh.path} ({mesh.about}; {mesh.triangles} triangles, {PACKAGE}, {LICENCE})")


def _methods(_: argparse.Namespace) -> None:
    for name, kind in prt.methods().items():
        print(f"{name:<16} {kind.role:<8} {kind.summary}")


def _check_method(args: argparse.Namespace) -> None:
    from prt_bench.contract import check

    failed = 0
    for result in check(prt.method(args.name, **_settings(args.set))):
        failed += not result.passed
        print(f"{'ok    ' if result.passed else 'FAILED'} {result.name}  {result.detail}")
    if failed:
        raise SpecError(f"method '{args.name}' fails {failed} checks of the contract")


def _stability(args: argparse.Namespace) -> int:
    """Exit status 1 when a goal is missed. With --out an interrupted scoreboard goes on where it was."""
    from prt_bench.stability import board, mutants, table
    from prt_bench.stability.journal import Journal

    journal = None
    if args.out:
        target = board.check_target(args.out)  # before minutes of work
        journal = Journal(target.with_name(target.name + ".cells"))
    cells = board.run(board.selected(args.case), args.route, jobs=args.jobs, journal=journal)
    killed = mutants.kills(known=cells, jobs=args.jobs) if args.mutations else ()
    found = board.goals(cells, killed)
    table.show(_out, cells, killed, found)
    if args.out:
        _out.print(f"scoreboard: {board.write(args.out, cells, killed)}", highlight=False, soft_wrap=True)
    if journal:
        journal.done()
    return int(not all(goal.met for goal in found))


def _doctor(_: argparse.Namespace) -> None:
    from prt_bench.doctor import print_report

    print_report()


def _bake_settings(args: argparse.Namespace) -> dict[str, Any]:
    names = ("lightings", "texels", "rays", "measurements", "supersampling", "tolerance", "gather_texels",
             "streamed", "measure_on", "vertices", "node_rays", "node_tolerance", "mips", "texture_set", "noise",
             "gather_tolerance")  # fmt: skip
    return {**{name: getattr(args, name) for name in names}, "ood": tuple(args.ood), "force": tuple(args.force)}


def _count_or_auto(text: str) -> int | str:
    """A number where it is one; what other words mean is the planner's to say."""
    return int(text) if text.removeprefix("-").isdecimal() else text


def _settings(pairs: Sequence[str]) -> dict[str, Any]:
    """KEY=VALUE words; values are read as TOML."""
    import tomllib

    settings = {}
    for pair in pairs:
        key, separator, text = pair.partition("=")
        if not separator or not key.strip():
            raise SpecError(f"setting '{pair}' is not KEY=VALUE")
        try:
            settings[key.strip()] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            settings[key.strip()] = text
    return settings


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="prt-bench", description="What accurate indirect light costs in real time.")
    parser.add_argument("--version", action="version", version=prt.__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: Any, text: str) -> argparse.ArgumentParser:
        made = commands.add_parser(name, help=text, description=text)
        made.set_defaults(run=run)
        return made

    run = command("run", _run, "bake, fit, evaluate, time and report: the main job")
    run.add_argument("spec", type=Path, metavar="SPEC.toml")
    run.add_argument("--out", type=Path, help="output folder (default: runs/NAME)")

    _bake_options(command("plan", _plan, "what a scene calls for, why, and at what cost"))
    made = command("bake", _bake, "trace a scene once and light it")
    _bake_options(made)
    made.add_argument("--seed", type=int, default=0)
    made.add_argument("--out", type=Path, help="folder for the stores (default: $PRT_BENCH_DATA or the user's cache)")
    made.add_argument("--workers", type=int, help="threads (default: one per core)")

    made = command("fit", _fit, "fit a method to a dataset and export it")
    made.add_argument("dataset", type=Path)
    made.add_argument("method")
    made.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of the method")
    made.add_argument("--storage", default="float32", choices=DTYPES)
    made.add_argument("--out", type=Path, required=True, help="folder of the asset")

    made = command("evaluate", _evaluate, "errors of an asset on held-out lightings")
    made.add_argument("asset", type=Path)
    made.add_argument("dataset", type=Path)
    made.add_argument("--split", default="test")

    made = command("time", _time, "time assets in the runtime and in JAX, interleaved")
    made.add_argument("dataset", type=Path)
    made.add_argument("assets", type=Path, nargs="+", metavar="ASSET")
    made.add_argument("--rounds", type=int, default=7)

    made = command("view", _view, "show an asset at work in a window, under the test lightings")
    made.add_argument("dataset", type=Path)
    made.add_argument("asset", type=Path)
    made.add_argument(
        "--environment", type=Path, action="append", default=[], metavar="EXR", help="a map to begin with"
    )

    made = command("report", _report, "write leaderboard and report from a run's records")
    made.add_argument("folder", type=Path)
    for name, run_command, text in (
        ("compare", _compare, "two methods side by side"),
        ("best", _best, "the most accurate rows within a budget"),
    ):
        made = command(name, run_command, text)
        if name == "compare":
            made.add_argument("a", metavar="A")
            made.add_argument("b", metavar="B")
        else:
            made.add_argument("--within", required=True, metavar="BUDGET", help="0.5ms, 2MB or 10s")
        made.add_argument(
            "--records", type=Path, default=Path("runs/quickstart"), help="a run's folder or records file"
        )

    command("scenes", _scenes, "built-in scenes")
    made = command("assets", _assets, "fetch the meshes of scenes that need one which is not vendored")
    made.add_argument("names", nargs="*", metavar="NAME", help="meshes to fetch (default: all)")
    command("methods", _methods, "transfer methods that are installed")
    made = command("check-method", _check_method, "run the contract tests on a method")
    made.add_argument("name", metavar="NAME")
    made.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of the method")
    made = command("stability", _stability, "hard cases for every method and dtype route, as a scoreboard with goals")
    made.add_argument(
        "--case", action="append", default=[], metavar="KEY", help="only this case of the catalogue, as A2"
    )
    made.add_argument("--route", action="append", default=[], choices=("f64", "f32", "f32 from f16", "f32 from bf16"))
    made.add_argument("--mutations", action="store_true", help="also put naive formulas in place of the sound ones")
    made.add_argument("--jobs", type=int, help="processes; one for each core without it")
    made.add_argument("--out", type=Path, help="a run's folder, whose report then shows the scoreboard, or a JSON file")
    command("doctor", _doctor, "what this machine offers, and what is missing for what")
    return parser


def _bake_options(made: argparse.ArgumentParser) -> None:
    made.add_argument("scene", help="a built-in scene, or a .glb .gltf .obj .ply .stl or .toml file")
    made.add_argument("--scenario", default="spot")
    for name, default in (
        ("lightings", 128),
        ("texels", 128),
        ("measurements", 256),
        ("supersampling", 8),
    ):
        made.add_argument(f"--{name}", type=int, default=default)
    made.add_argument("--tolerance", type=float, default=1e-4)
    made.add_argument("--rays", type=_count_or_auto, default=256, help="per point, or auto: as many as --noise needs")
    made.add_argument("--noise", type=float, default=0.02, help="split-half noise that --rays auto may leave")
    made.add_argument("--gather-texels", type=_count_or_auto, help="side, or auto: as few as --gather-tolerance allows")
    made.add_argument("--gather-tolerance", type=float, default=0.05, help="error of light bounced once that may be")
    made.add_argument(
        "--force", action="append", default=[], metavar="WHAT", help="simulate in full what is left out, or all"
    )
    made.add_argument("--streamed", type=int, default=0, help="further lightings kept as direct light alone")
    made.add_argument("--node-rays", type=int, default=0, help="trace receivers at nodes only, with so many rays each")
    made.add_argument("--node-tolerance", type=float, default=0.02, help="what interpolation between nodes may miss")
    made.add_argument("--vertices", action="store_true", help="trace vertices too, for transfer stored there")
    made.add_argument("--mips", type=int, default=0, help="how often the lightmap can be halved for far views")
    made.add_argument("--texture-set", action="store_true", help="a square of the lightmap for each material")
    made.add_argument("--measure-on", choices=("surface", "hull"), default="surface", help="where light is measured")
    made.add_argument("--ood", action="append", default=[], metavar="SCENARIO", help="another scenario to test on")


if __name__ == "__main__":
    sys.exit(main())
