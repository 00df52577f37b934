"""The command line: python -m rbsd_sym info|run|export|chart|stability|ocp MODEL."""

from __future__ import annotations

import argparse
import importlib.util
import os
import platform
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import rbsd_sym as rs

from .base.files import write_whole

_EPILOG = """
MODEL is a Python file that defines scene(). It may also define T_END (s), COLUMNS (names to plot)
and INPUTS (name: number, function of t, or samples) for `run` and `chart`, and STABILITY for
`stability`: the arguments of `study.stability_map` as {"x": {name: values}, "y": {name: values},
...}, optionally with "make". `ocp` needs problem(), and uses METHOD, GUESS, SOLVER and
picture(solution) if they are defined.

examples:
  python -m rbsd_sym info models/mini.py                    states, cost, notes
  python -m rbsd_sym run models/engine_mounts.py            integrate, plot, save
  python -m rbsd_sym run models/mini.py --t-end 2 --columns body.position spring.force_local
  python -m rbsd_sym run models/pair.py --animate gif       the same, and a film
  python -m rbsd_sym export models/engine_mounts.py         C code with header and model card
  python -m rbsd_sym chart models/mini.py                   error against CPU time of integrators
  python -m rbsd_sym stability models/engine_mounts.py      equilibrium, eigenvalues, frequencies
  python -m rbsd_sym stability models/kapitza.py            map of stability
  python -m rbsd_sym stability --all                        the stability atlas
  python -m rbsd_sym ocp models/crane.py --animate gif      plan, picture, and a film of the plan
"""
_FILM = 5.0  # s, the longest film
_INTEGRATORS = {"idas": rs.Idas, "rosenbrock": rs.Rosenbrock, "explicit": rs.ExplicitRK}


def main(arguments: list[str] | None = None) -> int:
    """Run a command of the command line.

    Arguments:
        arguments: those after `python -m rbsd_sym`; by default those of this process.

    Returns:
        The exit code: 0, or 1 after an error, which is printed in one line. A failed simulation is
        saved up to where it failed.
    """
    # Errors that a user can cause end in one line. Any other exception is a defect of the program,
    # and keeps its traceback.
    options = _parser().parse_args(arguments)
    commands: dict[str, Callable[[argparse.Namespace], None]] = {
        "info": _info,
        "run": _run,
        "export": _export,
        "chart": _chart,
        "stability": _stability,
        "ocp": _ocp,
    }
    try:
        commands[options.command](options)
    except (ValueError, TypeError, rs.EquilibriumError, rs.ocp.OptimisationError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except rs.IntegrationError as error:
        if options.command == "run":
            _finish(options, error.trajectory, None)
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m rbsd_sym",
        description="Scenes of rigid bodies and 6-DOF spring-dampers: model, simulation, C code.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(
        dest="command", required=True, metavar="info|run|export|chart|stability|ocp"
    )
    for name, text in (
        ("info", "print the model: states, start values, cost, notes"),
        ("run", "integrate, and write generated/<name>/<name>.npz and .png"),
        ("export", "write C code to generated/<name>/"),
        ("chart", "error against CPU time of integrators: generated/charts/<name>.png, .md, .csv"),
        ("stability", "map of stability, or equilibrium and eigenvalues; --all: stability atlas"),
        ("ocp", "optimise problem(), and write generated/<name>/<name>_plan.npz and .png"),
    ):
        command = commands.add_parser(name, help=text, description=text)
        one = "?" if name == "stability" else None
        command.add_argument("model", type=Path, nargs=one, help="Python file that defines scene()")
        if name == "ocp":
            _ocp_options(command)
        else:
            _compile_options(command)
        command.add_argument(
            "--folder", type=Path, default=Path("generated"), help="parent of the output folder"
        )
        if name == "run":
            _run_options(command)
        if name == "chart":
            command.add_argument("--t-end", type=float, help="end in s (default: T_END, or 1)")
            command.add_argument("--repeats", type=int, default=5, help="timed runs (default 5)")
        if name == "stability":
            _stability_options(command)
    return parser


def _compile_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--tait-bryan", action="store_true", help="Tait-Bryan xyz angles, not quaternions"
    )
    command.add_argument(
        "--full", action="store_true", help="keep the states that provably never move"
    )


def _ocp_options(command: argparse.ArgumentParser) -> None:
    command.add_argument("--progress", action="store_true", help="a line for every iteration")
    command.add_argument("--animate", choices=("gif", "html"), help="write a film of the plan")


def _run_options(command: argparse.ArgumentParser) -> None:
    command.add_argument("--t-end", type=float, help="end in s (default: T_END of the file, or 1)")
    command.add_argument("--integrator", choices=sorted(_INTEGRATORS), default="idas")
    command.add_argument("--rtol", type=float, default=1e-8, help="relative tolerance")
    command.add_argument("--atol", type=float, default=1e-10, help="absolute tolerance")
    command.add_argument("--columns", nargs="+", help="columns to plot (default: COLUMNS)")
    command.add_argument("--animate", choices=("gif", "html"), help="write a film of the motion")
    command.add_argument(
        "--set", nargs="+", default=[], metavar="NAME=VALUE", help="parameter values"
    )


def _stability_options(command: argparse.ArgumentParser) -> None:
    command.add_argument("--all", action="store_true", help="remake the stability atlas")
    command.add_argument("--page", type=int, help="remake one page of the atlas, by its number")
    command.add_argument("--short", action="store_true", help="the atlas in its short form")
    command.add_argument(
        "--set", nargs="+", default=[], metavar="NAME=VALUE", help="parameter values"
    )


def _info(options: argparse.Namespace) -> None:
    _, model = _compile(options)
    print(model)


def _run(options: argparse.Namespace) -> None:
    file, model = _compile(options)
    t_end = options.t_end if options.t_end is not None else getattr(file, "T_END", 1.0)
    integrator = _INTEGRATORS[options.integrator](rtol=options.rtol, atol=options.atol)
    with _progress(f"simulating {model.name} to t = {t_end:g} s with {type(integrator).__name__}"):
        trajectory = rs.simulate(
            model,
            t_end,
            integrator,
            inputs=getattr(file, "INPUTS", {}),
            params=_settings(options.set),
        )
    # The trajectory is saved before the film is drawn, which may take longer than the simulation.
    _finish(options, trajectory, getattr(file, "COLUMNS", None))
    if options.animate:
        film = options.folder / trajectory.name / f"{trajectory.name}.{options.animate}"
        length = min(_FILM, t_end)
        with _progress(f"drawing {film}"):
            rs.plots.animate(model, trajectory, film, duration=length)


def _finish(options: argparse.Namespace, trajectory: rs.Trajectory, columns: Any) -> None:
    """Save and draw a trajectory, also one that failed; print its report and statistics."""
    folder = options.folder / trajectory.name
    folder.mkdir(parents=True, exist_ok=True)
    chosen = options.columns or columns or list(trajectory.states[:3])
    # A run that failed at its start has one point, of which there is no curve to draw.
    if len(trajectory.t) > 1:
        figure = rs.plots.trajectory(trajectory, list(chosen))
        picture = folder / f"{trajectory.name}.png"
        _draw(figure, picture)
        print(f"wrote {picture}")
    print(f"wrote {trajectory.save(folder / f'{trajectory.name}.npz')}")
    counts = ", ".join(
        f"{key} {value if isinstance(value, str) else f'{value:.6g}'}"
        for key, value in trajectory.stats.items()
    )
    print(f"{trajectory}\n{counts}")


def _export(options: argparse.Namespace) -> None:
    _, model = _compile(options)
    with _progress(f"writing C of {model.name}"):
        artefact = rs.export_c(model, options.folder / model.name)
    print(f"wrote {artefact.folder} with {', '.join(artefact.functions)}")


def _chart(options: argparse.Namespace) -> None:
    file, model = _compile(options)
    t_end = options.t_end if options.t_end is not None else getattr(file, "T_END", 1.0)
    folder, inputs = options.folder / "charts", getattr(file, "INPUTS", {})
    folder.mkdir(parents=True, exist_ok=True)
    with _progress(f"charting {model.name} to t = {t_end:g} s"):
        rivals = rs.study.contenders(model, t_end)
        table = rs.study.work_precision(
            model, rivals, t_end, repeats=options.repeats, inputs=inputs
        )
    figure = rs.plots.work_precision(table, f"{model.name}, {t_end:g} s")
    _draw(figure, folder / f"{model.name}.png")
    # Times mean something only together with the machine, so the page names it.
    command = f"python -m rbsd_sym chart {options.model}"
    note = f"`{command}` on {platform.machine()}, {os.cpu_count()} cores, {rs.__version__}\n\n"
    text = f"# {model.name}: error against CPU time\n\n{note}{table.to_markdown()}"
    write_whole(folder / f"{model.name}.md", lambda file: file.write(text.encode()), "chart")
    table.to_csv(folder / f"{model.name}.csv")
    print(table)
    print(f"wrote {folder / model.name}.png, .md and .csv")


def _stability(options: argparse.Namespace) -> None:
    if options.all or options.page is not None:
        _atlas(options)
        return
    if options.model is None:
        raise ValueError("stability: no MODEL given; give one, or --all for the stability atlas")
    file, model = _compile(options)
    if hasattr(file, "STABILITY"):
        _map(options, model, dict(file.STABILITY))
        return
    inputs, params = getattr(file, "INPUTS", {}), _settings(options.set)
    with _progress(f"solving for the equilibrium of {model.name}"):
        rest = rs.static_equilibrium(model, inputs=inputs, params=params)
    print(rest)
    units = {label.name: label.unit for label in (*model.x_labels, *model.dae.z_labels)}
    for name, value in rest.state.items():
        print(f"  {name} = {value:.6g} {units[name]}".rstrip())
    print(rs.linearize(model, rest))


def _map(options: argparse.Namespace, model: rs.Model, arguments: dict[str, Any]) -> None:
    """Write the map of stability that a model file defines.

    Arguments:
        arguments: those of `study.stability_map`, from the file.
    """
    try:
        given = arguments.pop("make", model), arguments.pop("x"), arguments.pop("y")
    except KeyError as error:
        raise ValueError(
            f"{options.model}: STABILITY has no {error}; it needs 'x' and 'y', such as "
            '{"x": {"stiffness": [1e3, 2e3]}, "y": {"damping": [1, 2]}}'
        ) from error
    arguments["params"] = {**arguments.get("params", {}), **_settings(options.set)}
    folder = options.folder / "charts"
    folder.mkdir(parents=True, exist_ok=True)
    with _progress(f"mapping the stability of {model.name}"):
        table = rs.study.stability_map(*given, **arguments)
    stem = folder / f"{model.name}_stability"
    # Without a single good point there is nothing to draw, but the table holds the reasons.
    failed = sum(error is not None for error in table.column("error"))
    if failed < len(table.rows):
        _draw(rs.plots.stability_map(table, model.name), stem.with_suffix(".png"))
    command = f"python -m rbsd_sym stability {options.model}"
    text = f"# {model.name}: map of stability\n\n`{command}`, {rs.__version__}\n\n"
    text += f"![{model.name}]({stem.name}.png)\n\n{table.to_markdown()}"
    write_whole(stem.with_suffix(".md"), lambda file: file.write(text.encode()), "stability")
    table.to_csv(stem.with_suffix(".csv"))
    stable = sum(bool(value) for value in table.column("stable"))
    print(f"{stable} of {len(table.rows)} points are stable, {failed} failed")
    print(f"wrote {stem}.png, .md and .csv")


def _atlas(options: argparse.Namespace) -> None:
    """Write pages of the stability atlas; a page that fails does not stop the others."""
    atlas = _load_atlas(Path("models").resolve() / "atlas")
    every = atlas.pages()
    pages = [page for page in every if options.page in (None, page.number)]
    if not pages:
        numbers = ", ".join(str(page.number) for page in every)
        raise ValueError(
            f"stability --page {options.page}: no such page; there are: {numbers}; give one of them"
        )
    folder = options.folder / "charts" / "atlas"
    folder.mkdir(parents=True, exist_ok=True)
    failed = []
    for page in pages:
        try:
            with _progress(f"page {page.number}: {page.title}"):
                atlas.make(page, folder, full=not options.short)
        except Exception as error:  # of any type, since pages run code of their own
            failed.append(f"{page.number} ({type(error).__name__}: {error})")
    atlas.contents(folder)
    print(f"wrote {len(pages) - len(failed)} of {len(pages)} pages to {folder}")
    if failed:
        raise ValueError(f"stability: pages that failed: {'; '.join(failed)}")


def _load_atlas(folder: Path) -> ModuleType:
    """Import the stability atlas, a package beside the model files.

    Raises:
        ValueError: the folder does not hold it.
    """
    file = folder / "__init__.py"
    if not file.is_file():
        raise ValueError(
            f"stability: there is no {folder}; the stability atlas is part of the repository, not "
            "of the installed package; run the command from the repository's root"
        )
    spec = importlib.util.spec_from_file_location(
        "atlas", file, submodule_search_locations=[str(folder)]
    )
    if spec is None or spec.loader is None:
        raise ValueError(f"stability: {file} is not a Python package; restore it")
    # Pages import the package by its name, so it must be registered, and modules of another
    # checkout's atlas that this process has loaded must not be found in its place.
    for name in [n for n in sys.modules if n == "atlas" or n.startswith("atlas.")]:
        del sys.modules[name]
    module = importlib.util.module_from_spec(spec)
    sys.modules["atlas"] = module
    spec.loader.exec_module(module)
    return module


def _ocp(options: argparse.Namespace) -> None:
    file = load_model_file(options.model)
    if not callable(getattr(file, "problem", None)):
        raise ValueError(
            f"{options.model}: defines no problem(); write a function that returns an ocp.Problem"
        )
    with _progress(f"optimising {options.model}"):
        solution = rs.ocp.optimise(
            file.problem(),
            getattr(file, "METHOD", None),
            getattr(file, "GUESS", None),
            getattr(file, "SOLVER", None),
            _print_iteration if options.progress else None,
            throw=False,
        )
    if not solution.outcome.ok:
        raise rs.ocp.OptimisationError(solution)
    print(solution)
    for name, free in solution.problem.params.items():
        if isinstance(free, rs.ocp.Free):
            print(f"  {name} = {solution.params[name]:.9g}")
    plan = solution.trajectory
    folder = options.folder / plan.name
    folder.mkdir(parents=True, exist_ok=True)
    stem = folder / f"{plan.name}_plan"
    chosen = getattr(file, "COLUMNS", None) or list(plan.states[:3])
    drawn = file.picture(solution) if hasattr(file, "picture") else None
    _draw(drawn or rs.plots.trajectory(plan, chosen), stem.with_suffix(".png"))
    print(f"wrote {stem}.png\nwrote {plan.save(stem.with_suffix('.npz'))}")
    if options.animate:
        film = stem.with_suffix(f".{options.animate}")
        with _progress(f"drawing {film}"):
            rs.plots.animate(solution.model, plan, film, duration=min(_FILM, solution.t_end))


def _print_iteration(iteration: rs.ocp.Iteration) -> None:
    number, cost, violation = iteration
    print(f"{number:5d}  cost {cost:.8g}  violation {violation:.2e}", file=sys.stderr, flush=True)


def _draw(figure: Any, path: Path) -> None:
    write_whole(path, lambda file: figure.savefig(file, dpi=110, format="png"), "figure")


def _settings(pairs: list[str]) -> dict[str, float]:
    settings = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        try:
            settings[name] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise ValueError(f"--set {pair}: give NAME=VALUE, such as --set stiffness=500")
    return settings


def _compile(options: argparse.Namespace) -> tuple[ModuleType, rs.Model]:
    # Warnings of the model are printed after the line of progress, without Python's source lines.
    file = load_model_file(options.model)
    formulation = rs.TaitBryan() if options.tait_bryan else rs.Quaternion()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", rs.ModelWarning)
        with _progress(f"compiling {options.model}"):
            model = rs.compile_scene(file.scene(), formulation, minimal=not options.full)
    for warning in caught:
        print(f"warning: {warning.message}", file=sys.stderr)
    return file, model


def load_model_file(path: Path) -> ModuleType:
    """Import a model file by its path.

    Returns:
        The module, with the function scene() and whatever else the file defines.

    Raises:
        ValueError: there is no such file, or it does not define scene().
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file; give a Python file that defines scene()")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"{path}: not a Python file; give one that defines scene()")
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look up the types of their fields in the registered module.
    sys.modules.setdefault(path.stem, module)
    spec.loader.exec_module(module)
    if not callable(getattr(module, "scene", None)):
        raise ValueError(f"{path}: defines no scene(); write a function that returns a Scene")
    return module


@contextmanager
def _progress(what: str) -> Iterator[None]:
    """Print on stderr what runs and, when it is done, how long it took."""
    started = time.perf_counter()
    print(f"{what} ...", end="", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        print(f" {time.perf_counter() - started:.2f} s", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
