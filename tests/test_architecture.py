"""The layers hold: read from the source with `ast` alone, nothing of the package is imported."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "src" / "loopcal"

# From the ground up. Names on one line do not import each other; imports point downwards only.
LAYERS = (
    ("arrays", "errors", "import_path", "keys", "lazy", "companions"),
    ("chi_squared", "expressions", "units"),
    ("presentation", "small_samples"),
    ("execution",),
    ("mechanisms", "measurements"),
    ("document",),
    ("estimation", "simulation"),
    ("statistics", "files"),
    ("figures",),
    ("report",),
    ("workflow",),
    ("cli",),
    # What stands beside the core, which imports none of it.
    *(("companions.studies", "companions.performance", "companions.record", "companions.robot"),),
    ("companions.planning", "companions.life"),
    ("companions.app",),
)
HEIGHT = {name: height for height, names in enumerate(LAYERS) for name in names}
# The public face, the package and its namespaces, may import anything, and nothing imports it;
# `python -m loopcal` starts the command.
FACE = {"__init__", "effects", "instruments", "machines"}
ABOVE_ALL = {*FACE, "__main__"}

MOST_LINES = 600
"""So long a module holds more than one idea; a shorter one may do so too."""
SCREEN = 50
MOST_ARGUMENTS = 8
VAGUE_NAMES = {"utils", "util", "helpers", "helper", "misc", "common", "tools"}
SAY_NOTHING = {"found", "own", "known", "its", "told", "given", "here", "there"}
"""Words that say of a value where it came from, or to whom it belongs, but not what it is."""
NAMED = {
    *("mechanisms", "expressions", "measurements", "simulation", "figures", "presentation"),
    *("estimation", "execution", "report", "workflow", "cli"),
    *(f"companions.{name}" for name in ("planning", "life", "robot", "performance", "studies")),
    "companions.app",
    *("small_samples", "units", "errors", "chi_squared", "import_path"),
}
"""Layers in which every name says what its value is."""
PLOTTING = {"plotly", "matplotlib", "bokeh", "altair", "seaborn"}

MAY_TOUCH_DISK = {"files", "cli"}
FILES_OF_COMPANIONS = {
    *("companions.app.project_folder", "companions.life.history_folder"),
    *("companions.record.record_file", "companions.record.xml_schema"),
    *("companions.robot.exports.format", "companions.studies.run"),
}
"""Files that only a companion has."""
DISK_MODULES = {
    *("tempfile", "shutil", "glob", "fileinput", "sqlite3", "shelve", "runpy", "mmap"),
    *("scipy.io", "python_calamine", "h5py"),
}
DISK_FUNCTIONS = {"open", "Path.home", "Path.cwd"}
DISK_METHODS = {
    *("open", "read_text", "read_bytes", "write_text", "write_bytes", "tofile", "fromfile"),
    *("exists", "is_file", "is_dir", "iterdir", "rglob", "expanduser"),
    *("mkdir", "makedirs", "rmdir", "unlink", "touch", "chmod", "symlink_to", "listdir", "scandir"),
    *("loadtxt", "genfromtxt", "savetxt", "savez", "memmap", "loadmat", "savemat"),
    *("read_csv", "read_excel", "read_parquet", "scan_csv", "scan_parquet"),
    *("write_csv", "write_excel", "write_parquet", "sink_csv", "sink_parquet"),
    *("to_csv", "to_excel", "to_parquet", "spec_from_file_location"),
}


@dataclass(frozen=True)
class Module:
    """One source file: its dotted name inside the package, and its text."""

    name: str  # "expressions.tape"; "expressions.__init__" for a package
    text: str

    @cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.text)

    @cached_property
    def nodes(self) -> list[ast.AST]:
        return [*ast.walk(self.tree)]

    @cached_property
    def lines(self) -> list[str]:
        return self.text.splitlines()

    @property
    def layer(self) -> str:
        return layer_of(self.name)

    def imports(self) -> Iterator[tuple[int, str]]:
        """Line and absolute dotted name of everything imported, wherever in the file it stands."""
        for node in self.nodes:
            if isinstance(node, ast.Import):
                yield from ((node.lineno, alias.name) for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                # Dots climb from the file: the first names its own folder.
                parents = ["loopcal", *self.name.split(".")][: -node.level] if node.level else []
                base = [*parents, *([node.module] if node.module else [])]
                yield from ((node.lineno, ".".join([*base, alias.name])) for alias in node.names)
            elif isinstance(node, ast.Call) and dotted(node.func).endswith("import_module"):
                yield from ((node.lineno, name) for name in beginnings(node.args[:1]))

    def modules_in_strings(self) -> Iterator[tuple[int, str]]:
        """Line and dotted name of every module of the package that a string outside prose names."""
        prose = {id(node.value) for node in self.nodes if isinstance(node, ast.Expr)}
        for node in self.nodes:
            if isinstance(node, ast.Constant) and id(node) not in prose:
                for name in re.findall(r"loopcal(?:\.\w+)+", str(node.value)):
                    yield node.lineno, name

    def functions(self) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
        for node in self.nodes:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield node


def layer_of(name: str) -> str:
    """The folder of a module; of a companion, the companion."""
    first, *rest = name.split(".")
    beside = f"{first}.{rest[0]}" if rest else first
    return beside if beside in HEIGHT else first


def beginnings(names: list[ast.expr]) -> Iterator[str]:
    """What each name begins with, as far as the source states it; one that is computed has none."""
    for name in names:
        first = name.values[0] if isinstance(name, ast.JoinedStr) else name
        if isinstance(first, ast.Constant):
            yield str(first.value)


def dotted(node: ast.expr) -> str:
    """`a.b.c` as it is written; what is no name before the last dot is left out."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def source_modules() -> list[Module]:
    return [
        Module(".".join(path.relative_to(PACKAGE).with_suffix("").parts), path.read_text("utf-8"))
        for path in sorted(PACKAGE.rglob("*.py"))
    ]


def upward_imports(module: Module) -> list[str]:
    """Imports of loopcal, also by name, that do not point downwards."""
    if module.layer in FACE:
        return []
    found = []
    for line, target in {*module.imports(), *module.modules_in_strings()}:
        root, _, rest = target.partition(".")
        if root != "loopcal":
            continue
        layer = layer_of(rest)
        if layer == module.layer or (module.layer == "__main__" and layer == "cli"):
            continue
        if HEIGHT.get(layer, len(LAYERS)) >= HEIGHT.get(module.layer, -1):
            found.append(f"{module.name}:{line} imports {target}")
    return found


def computed_imports(module: Module) -> list[str]:
    """Imports whose name does not begin with a folder of the package that the source states."""
    return [
        f"{module.name}:{node.lineno} imports {ast.unparse(node.args[0])}"
        for node in module.nodes
        if isinstance(node, ast.Call)
        and dotted(node.func).endswith(("import_module", "__import__"))
        if not any(name.count(".") >= 2 for name in beginnings(node.args[:1]))
    ]


def private_imports(module: Module) -> list[str]:
    """Names with an underscore that are imported from another folder."""
    folder = ".".join(["loopcal", *module.name.split(".")[:-1]])
    return [
        f"{module.name}:{line} imports {name}"
        for line, name in module.imports()
        if name.startswith("loopcal.") and re.search(r"\._[a-z]", name.removeprefix(folder))
        if not name.startswith(f"{folder}._")
    ]


def disk_access(module: Module) -> list[str]:
    """Imports and calls that reach the disk."""
    if module.layer in MAY_TOUCH_DISK or module.name in FILES_OF_COMPANIONS:
        return []
    found = [
        f"{module.name}:{line} imports {name}"
        for line, name in module.imports()
        if any(name == disk or name.startswith(f"{disk}.") for disk in DISK_MODULES)
    ]
    for node in module.nodes:
        if isinstance(node, ast.Call):
            name = dotted(node.func)
            method = "." in name and name.rsplit(".", 1)[1] in DISK_METHODS
            if name in DISK_FUNCTIONS or method:
                found.append(f"{module.name}:{node.lineno} calls {name}()")
    return found


def length_on_screen(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function without its docstring."""
    lines = (function.end_lineno or function.lineno) - function.lineno + 1
    docstring = function.body[0] if ast.get_docstring(function) is not None else None
    if docstring is not None:
        lines -= (docstring.end_lineno or docstring.lineno) - docstring.lineno + 1
    return lines


def imported_by(modules: list[Module]) -> dict[str, set[str]]:
    """Module -> modules that it imports, imports for types and inside functions counted."""
    names = {module.name.removesuffix(".__init__") for module in modules}
    return {
        (name := module.name.removesuffix(".__init__")): {
            part
            for _, target in module.imports()
            for part in (target.removeprefix("loopcal."), target[8:].rpartition(".")[0])
            if target.startswith("loopcal.") and not target.endswith(".")  # of a computed name
            if part in names and part != name
        }
        for module in modules
        if module.layer not in ABOVE_ALL
    }


def import_cycles(modules: list[Module]) -> list[frozenset[str]]:
    """Modules that import each other, imports for types and inside functions counted."""
    below = imported_by(modules)
    reached = {name: reached_from(name, below) for name in below}
    cycles = {frozenset(o for o in reached[n] if n in reached[o]) for n in below if n in reached[n]}
    return sorted(cycles, key=sorted)


def reached_from(name: str, below: dict[str, set[str]]) -> set[str]:
    """All modules that one imports, itself only if it imports itself by others."""
    found: set[str] = set()
    ahead = [*below[name]]
    while ahead:
        other = ahead.pop()
        if other not in found:
            found.add(other)
            ahead += below.get(other, ())
    return found & set(below)


def arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """How many a function takes, without self; *args and **kwargs count as one each."""
    own = function.args
    named = [a.arg for a in (*own.posonlyargs, *own.args, *own.kwonlyargs)]
    collected = [a for a in (own.vararg, own.kwarg) if a is not None]
    return len([name for name in named if name not in ("self", "cls")]) + len(collected)


def is_command(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether it is a command of the command line, whose arguments are options."""
    return any(
        isinstance(d, ast.Call) and dotted(d.func) == "app.command" for d in function.decorator_list
    )


MODULES = source_modules()


def method_names() -> set[str]:
    """The names in the registry of methods, but "auto", which is also a start."""
    registry = next(m for m in MODULES if m.name == "estimation.methods.registry")
    rows = next(node.value for node in registry.tree.body if isinstance(node, ast.Assign))
    assert isinstance(rows, ast.Dict)
    return {str(key.value) for key in rows.keys if isinstance(key, ast.Constant)} - {"auto"}


def test_there_is_a_package_to_look_at() -> None:
    assert {"__init__", "errors", "units"} <= {module.name for module in MODULES}


def test_contributing_shows_the_layers() -> None:
    page = PACKAGE.parents[1] / "CONTRIBUTING.md"
    block = re.search(r"```text\n(companions.*?)\n```", page.read_text("utf-8"), re.DOTALL)
    assert block is not None
    assert [{*line.split(" | ")} for line in block[1].splitlines()] == [*map(set, LAYERS[::-1])]


def test_every_folder_and_module_is_a_layer() -> None:
    assert {module.layer for module in MODULES} <= set(HEIGHT) | ABOVE_ALL


def test_imports_point_downwards_only() -> None:
    assert [line for module in MODULES for line in upward_imports(module)] == []


def test_an_import_states_its_folder() -> None:
    # Both call, in another process and by its name, a function that their caller has imported.
    by_caller = {"files.guarded", "files.tables.isolated"}
    looked_at = [m for m in MODULES if m.layer not in FACE and m.name not in by_caller]
    assert [line for module in looked_at for line in computed_imports(module)] == []


def test_a_private_name_stays_in_its_folder() -> None:
    assert [line for module in MODULES for line in private_imports(module)] == []


def test_no_modules_import_each_other() -> None:
    assert import_cycles(MODULES) == []


def test_the_core_names_no_companion() -> None:
    # It calls them by the names that `loopcal.companions` holds; only the rows of the commands say
    # where these are.
    core = [m for m in MODULES if not m.name.startswith("companions.") and m.layer not in FACE]
    named = {
        module.name
        for module in core
        for node in module.nodes
        if isinstance(node, ast.Constant) and "companions." in str(node.value)
        if not any(isinstance(one, ast.Expr) and one.value is node for one in module.nodes)
    }
    assert named == {"cli.registry"}
    imported = {name for module in core for _, name in module.imports() if ".companions" in name}
    assert imported == {"loopcal.companions.called", "loopcal.companions.load"}


def test_a_cycle_by_types_or_inside_a_function_is_found() -> None:
    one = Module("estimation.a", "if TYPE_CHECKING:\n    from loopcal.estimation.b import f")
    two = Module("estimation.b", "def f():\n    from loopcal.estimation.a import g")
    three = Module("estimation.c", "from loopcal.estimation.a import g")
    assert import_cycles([one, two, three]) == [{"estimation.a", "estimation.b"}]
    assert import_cycles([one, three]) == []


def test_only_files_touches_the_disk() -> None:
    assert [line for module in MODULES for line in disk_access(module)] == []


def test_only_figures_knows_a_plotting_library() -> None:
    found = [
        f"{module.name}:{line} imports {name}"
        for module in MODULES
        for line, name in module.imports()
        if name.split(".")[0] in PLOTTING and module.layer != "figures"
    ]
    assert found == []


def test_the_deprecated_odr_of_scipy_is_never_used() -> None:
    names = {name for module in MODULES for _, name in module.imports()}
    assert not {name for name in names if name.startswith("scipy.odr")}


def test_no_module_is_long() -> None:
    lengths = {module.name: len(module.text.splitlines()) for module in MODULES}
    assert {name: n for name, n in lengths.items() if n > MOST_LINES} == {}


def test_nine_functions_of_ten_fit_one_screen() -> None:
    lengths = {
        f"{module.name}.{function.name}": length_on_screen(function)
        for module in MODULES
        for function in module.functions()
    }
    long = {name: length for name, length in lengths.items() if length > SCREEN}
    assert len(long) <= len(lengths) / 10, long


def test_no_function_takes_more_than_eight_arguments() -> None:
    many = {
        f"{module.name}.{function.name}": arguments(function)
        for module in MODULES
        for function in module.functions()
        if arguments(function) > MOST_ARGUMENTS and not is_command(function)
    }
    assert many == {}


def test_a_method_is_named_where_it_is_defined_and_compared_nowhere() -> None:
    texts = [p for p in PACKAGE.rglob("*") if p.suffix in (".py", ".toml", ".html", ".js")]
    named = [path for path in texts if "least-squares" in path.read_text("utf-8")]
    assert len(named) <= 6, named
    names = method_names()
    assert "least-squares" in names
    compared = [
        f"{module.name}:{node.lineno}"
        for module in MODULES
        for node in module.nodes
        if isinstance(node, ast.Compare)
        for part in (node.left, *node.comparators)
        if isinstance(part, ast.Constant) and part.value in names
    ]
    assert compared == []


def test_every_module_says_what_it_holds() -> None:
    assert [module.name for module in MODULES if not ast.get_docstring(module.tree)] == []


def stray_strings(module: Module) -> list[str]:
    """Strings that are statements without being docstrings, as a sentence that broke off leaves."""
    found = []
    for node in module.nodes:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant | ast.JoinedStr):
            text = module.lines[node.lineno - 1].encode()[node.col_offset :].decode()
            if not text.startswith(('"""', 'r"""')) and not text.startswith("..."):
                found.append(f"{module.name}:{node.lineno} {text}")
    return found


def test_no_sentence_is_broken_off() -> None:
    assert [line for module in MODULES for line in stray_strings(module)] == []
    assert stray_strings(Module("a", 'x = "begun, "\n"broken off"'))


def test_no_module_has_a_vague_name() -> None:
    assert [m.name for m in MODULES if VAGUE_NAMES & set(m.name.split("."))] == []


def names_made(module: Module) -> Iterator[tuple[int, str]]:
    """Line and name of every variable, argument, attribute, function and class that it defines."""
    for node in module.nodes:
        if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id if isinstance(node, ast.Name) else node.attr
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.lineno, node.name


def names_that_say_nothing(module: Module) -> list[str]:
    made = names_made(module)
    return [f"{module.name}:{n} {name}" for n, name in made if SAY_NOTHING & {*name.split("_")}]


def test_a_name_says_what_its_value_is() -> None:
    named = [module for module in MODULES if module.layer in NAMED]
    assert [line for module in named for line in names_that_say_nothing(module)] == []


def test_a_name_that_does_not_is_found() -> None:
    text = "def f(known, x):\n    its_sd = x.own = known\n    return unknown"
    assert len(names_that_say_nothing(Module("a", text))) == 3


def test_nothing_is_left_for_later() -> None:
    marks = ("TODO", "FIXME", "XXX", "NotImplementedError")
    assert [m.name for m in MODULES if any(mark in m.text for mark in marks)] == []


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("estimation.kernel", "from loopcal.files import read_dataset"),
        ("estimation.kernel", "def f():\n    from loopcal.workflow import calibrate"),
        ("estimation.kernel", "import loopcal.simulation.simulate"),
        ("estimation.kernel", "from ..files import read_dataset"),
        ("estimation.__init__", "from ..files import read_dataset"),
        ("estimation.kernel", "from .. import files"),
        ("estimation.kernel", "from loopcal import calibrate"),
        ("estimation.kernel", "from loopcal.machines import five_bar"),
        ("workflow", "from loopcal import instruments"),
        ("estimation.kernel", "import importlib\nimportlib.import_module('loopcal.cli')"),
        ("estimation.kernel", "importlib.import_module(f'loopcal.cli.{name}')"),
        ("estimation.kernel", "call_later('loopcal.cli.run:main')"),
        ("measurements.noise", "from loopcal.mechanisms import Mechanism"),
        ("units", "from loopcal.expressions import tape"),
        ("errors", "import loopcal"),
        ("__main__", "from loopcal.workflow import calibrate"),
    ],
)
def test_an_import_upwards_or_sideways_is_found(name: str, text: str) -> None:
    assert upward_imports(Module(name, text))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("estimation.kernel", "from loopcal.expressions.tape import Tape"),
        ("estimation.kernel", "from .reduction import reduce"),
        ("estimation.__init__", "from .kernel import reduce"),
        ("estimation.kernel", "from ..errors import InputError"),
        ("estimation.kernel", "import numpy as np"),
        ("files.result_file", "from loopcal.estimation.result import Result"),
        ("cli.calibrate", "from loopcal import workflow"),
        ("__main__", "from loopcal.cli import main"),
        ("__init__", "from loopcal.workflow import calibrate"),
        ("machines", "from loopcal.files.machines.urdf import urdf_machine"),
    ],
)
def test_an_import_downwards_is_not(name: str, text: str) -> None:
    assert upward_imports(Module(name, text)) == []


@pytest.mark.parametrize(
    "text", ["import_module(name)", "import_module(f'loopcal.{name}')", "__import__(NAMES[kind])"]
)
def test_an_import_of_a_computed_folder_is_found(text: str) -> None:
    assert computed_imports(Module("estimation.kernel", text))


@pytest.mark.parametrize(
    "text",
    [
        "from loopcal.estimation.solve.newton import _step",
        "from loopcal.files._kept import f",
        "from .solve.newton import _step",
    ],
)
def test_a_private_name_of_another_folder_is_found(text: str) -> None:
    assert private_imports(Module("estimation.kernel", text))
    inside = "from loopcal.estimation._compiled import f\nfrom .solve.newton import step"
    assert private_imports(Module("estimation.kernel", inside)) == []


@pytest.mark.parametrize(
    "text",
    [
        "def f(name):\n    with open(name) as file:\n        return file.read()",
        "path.write_text('x')",
        "(folder / 'x').read_bytes()",
        "import tempfile",
        "from scipy import io",
        "from scipy.io import loadmat",
        "np.loadtxt('x')",
        "os.makedirs('x')",
    ],
)
def test_reaching_for_the_disk_is_found(text: str) -> None:
    assert disk_access(Module("estimation.kernel", text))
    assert disk_access(Module("files.atomic", text)) == []


def test_only_one_module_prints() -> None:
    printing = {
        module.name
        for module in MODULES
        for node in module.nodes
        if isinstance(node, ast.Call)
        and dotted(node.func) in ("print", "sys.stdout.write", "sys.stderr.write", "typer.echo")
    }
    assert printing <= {"cli.output", "cli.__init__"}  # the latter before anything is loaded
