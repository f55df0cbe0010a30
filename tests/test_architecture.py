"""Packages import only from layers below them, no modules import one another, prbench never imports its adapters.

``python -m tests.test_architecture`` writes the table of layers in docs/architecture.md again.
"""

from __future__ import annotations

import ast
import re
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).parents[1]

LAYERS = {
    **dict.fromkeys(("diagnosis", "limits", "shown", "randomness"), 0),
    "errors": 1,
    **dict.fromkeys(("entry_points", "geometry", "progress_bar"), 2),
    **dict.fromkeys(("datasets", "files"), 3),
    "protocol": 4,
    **dict.fromkeys(("engine", "recording"), 5),
    **dict.fromkeys(("metrics", "object_stores", "sequences", "representation", "text"), 6),
    **dict.fromkeys(("contract", "readers", "tables"), 7),
    **dict.fromkeys(("curation", "release"), 8),
    **dict.fromkeys(("alignment", "synthetic", "checking/doctor"), 9),
    "harness": 10,
    "viewing": 11,
    **dict.fromkeys(("checking", "board", "prbench_adapters"), 12),
    **dict.fromkeys(("api", "cli"), 14),
    "commands": 15,  # modules or packages of this name in prbench_adapters and prbench_benchmarks
    "prbench_data_manifests": 0,
    "prbench_benchmarks": 0,
}
"""Every package, or module beside the packages, and its layer: imports point to lower layers only."""


def _modules() -> list[tuple[str, Path]]:
    folders = {"prbench": "prbench", "prbench_adapters": "adapters"}
    return [
        (".".join((package, *path.relative_to(ROOT / folder).with_suffix("").parts)).removesuffix(".__init__"), path)
        for package, folder in folders.items()
        for path in sorted((ROOT / folder).rglob("*.py"))
    ]


def _package(module: str) -> str | None:
    if module in ("prbench", "prbench.__main__"):
        return None  # the version line, and the way in for `python -m`
    parts = module.split(".")
    if parts[0] != "prbench":
        return "commands" if "commands" in parts[1:] else parts[0]
    if parts[1] == "readers" and len(parts) == 4 and parts[3].startswith("synthetic"):
        return "synthetic"  # what a dataset's sensors see, beside the reader that it imports
    if parts[1:3] == ["checking", "doctor"]:
        return "checking/doctor"  # judges motions for whatever scores them, and knows no file
    return parts[1]


def _imports(path: Path) -> list[str]:
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide the layer"
            found += (
                [f"{node.module}.{alias.name}" for alias in node.names] if node.module == "prbench" else [node.module]
            )
    return [name for name in found if name.split(".")[0].startswith("prbench")]


@pytest.mark.parametrize(("module", "path"), _modules(), ids=lambda value: value if isinstance(value, str) else "")
def test_imports_point_downwards(module, path):
    package = _package(module)
    if package is None:
        return  # the package itself, and ``python -m prbench``
    assert package in LAYERS, f"{module} stands in a package without a layer; add it to docs/architecture.md first"
    for imported in _imports(path):
        target = _package(imported)
        assert not (
            module.split(".")[0] == "prbench" and imported.split(".")[0] in ("prbench_adapters", "prbench_benchmarks")
        ), f"{module} imports {imported}: packages beside prbench are reached through entry points alone"
        if target is None or target == package:
            continue
        assert LAYERS[target] < LAYERS[package], (
            f"{module} (layer {LAYERS[package]}) imports {imported} (layer {LAYERS[target]})"
        )


def test_an_upward_import_would_be_noticed(tmp_path):
    file = tmp_path / "x.py"
    file.write_text("from prbench.cli import main\nimport prbench.sequences.table\nfrom prbench import geometry\n")
    assert [_package(name) for name in _imports(file)] == ["cli", "sequences", "geometry"]
    assert LAYERS["cli"] > LAYERS["sequences"] > LAYERS["geometry"]


def _imported_modules(path: Path, modules: set[str]) -> set[str]:
    """Modules that a file imports anywhere: inside functions and for type checking alone, too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                found.add(submodule if submodule in modules else node.module)
    return found & modules


def _circles(imports: dict[str, set[str]]) -> list[set[str]]:
    """Groups of modules of which each imports all others, directly or through further ones."""
    names = sorted(imports)
    place = {name: index for index, name in enumerate(names)}
    edges = [(place[name], place[other]) for name in names for other in imports[name] - {name}]
    rows, columns = np.transpose(edges)
    graph = coo_array((np.ones(len(edges)), (rows, columns)), shape=(len(names), len(names)))
    _, groups = connected_components(graph, directed=True, connection="strong")
    return [
        {names[index] for index in np.flatnonzero(groups == group)} for group in np.flatnonzero(np.bincount(groups) > 1)
    ]


def test_no_modules_import_one_another():
    paths = dict(_modules())
    circles = _circles({module: _imported_modules(path, set(paths)) for module, path in paths.items()})
    assert circles == []


def test_a_circle_would_be_noticed(tmp_path):
    sources = {
        "a": "def f():\n    import b\n",
        "b": "if False:\n    from c import x\n",
        "c": "from a import f\n",
        "d": "import a\n",
    }
    for name, source in sources.items():
        (tmp_path / f"{name}.py").write_text(source)
    imports = {name: _imported_modules(tmp_path / f"{name}.py", set(sources)) for name in sources}
    assert _circles(imports) == [{"a", "b", "c"}]


LOOKS = {"require_size", "open_regular", "opened"}
"""Refuse what is no regular file, or too large, before a byte is read."""
PYTHON_OPENS = {"open", "os.open", "io.open", "*.read_text", "*.read_bytes"}
LIBRARIES_OPEN = {
    "*.ZipFile", "*.is_zipfile", "h5py.File", "np.load", "np.memmap", "np.fromfile", "np.loadtxt", "np.genfromtxt",
    "pq.ParquetFile", "pq.read_table", "pq.read_metadata", "pq.read_schema", "gzip.open",
    "pyarrow.csv.read_csv", "pyarrow.csv.open_csv",
    "pa.memory_map", "pa.OSFile", "torch.load", "*.load_file", "*.safe_open", "trimesh.load", "trimesh.load_mesh",
    "*.from_pretrained", "sqlite3.connect", "shutil.copyfile", "shutil.copy", "shutil.copytree", "tarfile.open",
    "*.get_reader",
}  # fmt: skip
LAST_NAMES = {pattern.rpartition(".")[2] for pattern in PYTHON_OPENS | LIBRARIES_OPEN}
NO_FILES_OF_USERS = {
    "prbench/files/bounded.py": "here it is that files are looked at before they are opened",
    "prbench/api/pictures.py": "the picture that was made a moment ago",
    "prbench/engine/node_facts.py": "prbench's own code, and a file that another node of a cluster has just written",
    "prbench/engine/shards.py": "prbench's own code",
    "prbench/engine/unseen.py": "what the system says of this process, and its working directory",
    "prbench/files/storage.py": "locks, and what was written a moment ago",
    "prbench/harness/methods/worker.py": "the pipes of a worker",
    "prbench/harness/methods/installed.py": "the code of installed packages",
    "prbench/object_stores/inputs.py": "prbench's own cache",
    "prbench/object_stores/outputs.py": "prbench's own cache",
    "prbench/protocol/*.py": "TOML files of installed packages",
    "prbench/checking/hd_epic.py": "numbers of an installed package",
    "prbench/entry_points.py": "metadata of installed packages",
    "prbench/viewing/player/page.py": "the player's own scripts and styles",
    "prbench/readers/*/synthetic.py": "synthetic files that are being written",
    "prbench/sequences/parts.py": "parts of a table that is being written",
    "adapters/training/store.py": "prbench's own code",
    "benchmarks/speed/*.py": "measures raw reading, and is not installed",
}
"""Files that may open what they like, and why."""


def _raw_openings(source: str) -> list[str]:
    """Return the calls that open a file for reading which nothing in the same function has looked at."""
    if not re.search(r"open|read_|load|ZipFile|h5py|parquet|np\.|from_pretrained|connect", source):
        return []
    tree = ast.parse(source)
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    found = []
    for scope in functions or [tree]:
        calls = [node for node in ast.walk(scope) if isinstance(node, ast.Call)]
        last_names = [getattr(call.func, "attr", getattr(call.func, "id", "")) for call in calls]
        looked_at = not LOOKS.isdisjoint(last_names)
        for call in (call for call, name in zip(calls, last_names, strict=True) if name in LAST_NAMES):
            called = ast.unparse(call.func)
            is_python = any(fnmatch(called, pattern) for pattern in PYTHON_OPENS)
            is_library = any(fnmatch(called, pattern) for pattern in LIBRARIES_OPEN)
            if not (is_python or (is_library and not looked_at)):
                continue
            mode = ast.unparse(call.args[1]).strip("'\"") if len(call.args) > 1 else ""
            harmless = re.search(r"\bfiles\(|__file__|spec\.origin|BytesIO\(|BufferReader\(", ast.unparse(call))
            if mode[:1] not in ("w", "a", "x") and not harmless:
                found.append(ast.unparse(call))
    return found


def test_files_of_users_are_looked_at_before_they_are_opened():
    raw = {}
    for folder in ("prbench", "adapters", "benchmarks"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            found = _raw_openings(path.read_text(encoding="utf-8"))
            if found and not any(fnmatch(name, allowed) for allowed in NO_FILES_OF_USERS):
                raw[name] = found
    assert raw == {}, "read them through prbench.files.bounded: links to devices and endless files are told there"


@pytest.mark.parametrize(
    ("body", "raw"),
    [
        ("return open(path).read()", 1),
        ("return path.read_bytes()", 1),
        ("require_size(path)\n    return path.read_text()", 1),
        ("return np.load(path)", 1),
        ("require_size(path)\n    return np.load(path)", 0),
        ("with bounded.open_regular(path) as file:\n        return zipfile.ZipFile(file)", 0),
        ("open(path, 'wb').write(b'')", 0),
        ("return read_whole(path)", 0),
    ],
)
def test_a_raw_opening_would_be_noticed(body, raw):
    assert len(_raw_openings(f"def f(path):\n    {body}\n")) == raw


PAGE = ROOT / "docs" / "architecture.md"
BEGIN = "<!-- layers: python -m tests.test_architecture -->"
END = "<!-- end of layers -->"


def _purpose(package: str) -> tuple[str, str]:
    """Path of a package or module, and the first sentence of its docstring."""
    folder = ROOT / "adapters" if package == "prbench_adapters" else ROOT / "prbench" / package
    path = folder / "__init__.py"
    if not path.is_file():
        path = folder.with_suffix(".py")
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    shown = path.parent if path.name == "__init__.py" else path
    return str(shown.relative_to(ROOT)) + "/" * shown.is_dir(), " ".join(docstring.split("\n\n")[0].split())


def _table_of_layers() -> str:
    rows = ["| layer | package | what it holds |", "|---|---|---|"]
    for package, layer in sorted(LAYERS.items(), key=lambda item: (-item[1], item[0])):
        if package not in ("commands", "prbench_data_manifests", "prbench_benchmarks"):
            path, purpose = _purpose(package)
            if path.endswith(".py") and package not in ("contract", "recording"):
                continue  # single modules at the bottom: names, limits, errors
            purpose = re.sub(r":\w+:`[\w.~]*?(\w+)`", r"`\1`", purpose).replace("``", "`")
            rows.append(f"| {layer} | `{path}` | {purpose} |")
    return "\n".join(rows)


def _with_table(page: str) -> str:
    before, rest = page.split(BEGIN)
    return f"{before}{BEGIN}\n\n{_table_of_layers()}\n\n{END}{rest.split(END)[1]}"


def test_the_page_shows_the_layers_that_are_tested():
    page = PAGE.read_text(encoding="utf-8")
    assert page == _with_table(page), "write it again: python -m tests.test_architecture"


def test_every_path_on_the_page_exists():
    found = re.findall(
        r"`((?:prbench|adapters|benchmarks|data_manifests|tests|docs)/[\w./*<>-]*)`", PAGE.read_text("utf-8")
    )
    missing = [path for path in found if "<" not in path and not list(ROOT.glob(path.rstrip("/")))]
    assert len(found) > 30
    assert missing == []


if __name__ == "__main__":
    PAGE.write_text(_with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
