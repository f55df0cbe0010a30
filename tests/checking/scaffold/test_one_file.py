"""The one file of converters gives the same numbers as prbench's own, in this Python and in an old one."""

from __future__ import annotations

import ast
import importlib.util
import shutil
import subprocess
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import prbench.contract
import prbench.errors
from prbench import randomness, representation
from prbench.checking.scaffold import one_file
from prbench.cli import main
from prbench.geometry import skeleton
from prbench.geometry.skeleton import z_up
from prbench.representation import converters, encode, encoding
from tests.checking.scaffold import calculations
from tests.docs.interpreters import older_python
from tests.representation.converters.bodies import person, person_rotations
from tests.representation.converters.test_features import absolute
from tests.representation.converters.test_smpl import written

OURS = SimpleNamespace(
    **{
        name: getattr(module, name)
        for module in (
            randomness, skeleton, representation, encoding, converters, prbench.contract, prbench.errors
        )
        for name in dir(module)
        if not name.startswith("_")
    }
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Beside one another: the file, the calculations, and what they are given."""
    folder = tmp_path_factory.mktemp("one-file")
    assert main(["adapters", "list", "--converters", str(folder / one_file.ONE_FILE)]) == 0
    shutil.copy(calculations.__file__, folder / "calculations.py")
    np.savez(folder / "given.npz", **given())
    return folder


def given() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    walk = person(80, 430)  # here the person walks: people who stand give no reason to refuse the scale of their steps
    features = encode(walk)
    joints, rotations = person_rotations(40, 300)
    mean = rng.normal(size=263).astype(np.float32)
    std = rng.uniform(0.1, 2, size=263).astype(np.float32)
    arrays = {
        "features": features,
        "absolute": absolute(features),
        "mean": mean,
        "std": std,
        "standardised": (features - mean) / std,
        "initial": person(1, 1500)[0].astype(np.float64),
        "body": walk.astype(np.float64),
        "foreign": z_up(walk.astype(np.float64)) * np.array([-1, 1, 1]) * 1000,
        "times": np.cumsum(rng.uniform(0.01, 0.05, size=len(walk))),
        "rest": joints[0],
        "transl": joints[:, 0],
    }
    arrays |= {form: written(rotations, form) for form in calculations.ROTATIONS}
    for name, skeleton_map in converters.JOINT_MAPS.items():
        arrays[f"joints {name}"] = rng.normal(size=(5, len(skeleton_map.source_joints), 3))
    return arrays


@pytest.fixture(scope="module")
def the_file(folder) -> ModuleType:
    spec = importlib.util.spec_from_file_location("prbench_converters_of_the_test", folder / one_file.ONE_FILE)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.mark.unchecked_shapes
def test_it_gives_the_numbers_and_the_words_of_prbench(folder, the_file) -> None:
    ours, theirs = (calculations.calculated(c, given()) for c in (OURS, the_file))
    assert ours.keys() == theirs.keys()
    assert [name for name in ours if not np.array_equal(ours[name], theirs[name])] == []
    assert calculations.refusals(the_file, given()) == calculations.refusals(OURS, given())
    assert len(calculations.refusals(OURS, given())) == 3


def test_it_offers_every_converter_and_documents_none_that_is_missing(the_file) -> None:
    assert set(converters.__all__) - set(the_file.__all__) == set()
    assert set(the_file.__all__) <= set(vars(the_file))


def test_it_needs_numpy_alone_and_parses_as_python_3_8(folder) -> None:
    text = (folder / one_file.ONE_FILE).read_text()
    tree = ast.parse(text, feature_version=(3, 8))
    subscripts = [node.value for node in tree.body if isinstance(getattr(node, "value", None), ast.Subscript)]
    assert not [alias for alias in map(ast.unparse, subscripts) if alias.startswith(("tuple[", "list[", "dict["))]
    guarded = [node for node in tree.body if isinstance(node, ast.If)]
    imported = {
        name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom) and not any(node in block.body for block in guarded)
        for name in ([node.module] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names])
    }
    # torch is imported in a block of sequence_noise, tomllib by a reader of maps; both when they are asked for
    assert imported - set(sys.stdlib_module_names) == {"numpy", "torch"}


def test_an_old_python_gives_the_same_numbers(folder) -> None:
    _, python = older_python()
    command = [python, "calculations.py", "given.npz", "found.npz"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    ours = calculations.calculated(OURS, given())
    with np.load(folder / "found.npz") as found:
        assert set(found.files) == {*ours, "__said__"}
        for name, values in ours.items():
            assert np.allclose(found[name], values, rtol=0, atol=1e-6), name
        assert found["__said__"].tolist() == calculations.refusals(OURS, given())


def test_it_is_written_anew_but_over_nothing_else(folder, tmp_path, capsys) -> None:
    path = tmp_path / one_file.ONE_FILE
    shutil.copy(folder / one_file.ONE_FILE, path)
    with path.open("a") as file:
        file.write("# from an older version\n")
    assert main(["adapters", "list", "--converters", str(path)]) == 0
    assert path.read_bytes() == (folder / one_file.ONE_FILE).read_bytes()
    path.write_text("print('mine')\n")
    assert main(["adapters", "list", "--converters", str(path)]) == 8
    assert "something else than the converters" in capsys.readouterr().err
    assert path.read_text() == "print('mine')\n"


def test_two_modules_with_a_name_in_common_are_told(tmp_path, monkeypatch) -> None:
    (tmp_path / "prbench_first.py").write_text("_SIZE = 2\n\n\ndef first():\n    return _SIZE\n")
    second = (
        'from prbench_first import first\n\n# Why it is three.\n_THREE = 3\n"""Of the second."""\n'
        "UNUSED = 1\n\n\ndef second():\n    return first() * _THREE\n"
    )
    (tmp_path / "prbench_second.py").write_text(second)
    (tmp_path / "prbench_third.py").write_text(second.replace("_THREE", "_SIZE"))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(one_file, "_PACKAGES", ("prbench_first",))
    text = one_file.one_file({"prbench_second": ("second",)}, '"""Both."""\n')
    names: dict = {}
    exec(compile(text, "both", "exec"), names)
    assert names["second"]() == 6
    assert "UNUSED" not in text
    assert '# Why it is three.\n_THREE = 3\n"""Of the second."""' in text
    with pytest.raises(AssertionError, match="two modules make _SIZE; rename one of each"):
        one_file.one_file({"prbench_third": ("second",)}, "")
