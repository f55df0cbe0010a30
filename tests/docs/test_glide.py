"""docs/examples/glide.py and glide.mjs: one method, two languages, written from docs/wire-protocol.md."""

from __future__ import annotations

import ast
import dataclasses
import io
import json
import subprocess
import sys
import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.contract import Condition
from prbench.geometry.skeleton import WRISTS, bone_lengths
from prbench.harness.offline import ExportRequest, export_conditions, read_conditions_file
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import read_scores
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from tests.docs.by_hand import ByHand
from tests.docs.exchange import Exchange, decoded
from tests.docs.interpreters import EXAMPLES, javascript, older_python
from tests.fakes import STANDING
from tests.harness.offline.method import batches_of

GOALS = [Condition.GOAL_LOCATION, Condition.GOAL_POSE]
SOURCE = (EXAMPLES / "glide.py").read_text(encoding="utf-8")


def test_the_file_is_python_3_8_and_needs_numpy_and_pyarrow_alone():
    tree = ast.parse(SOURCE, feature_version=(3, 8))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert imported - sys.stdlib_module_names == {"numpy", "pyarrow"}


@pytest.mark.parametrize("condition", GOALS)
def test_every_motion_has_its_length_and_starts_in_the_given_pose(glide, batch, condition):
    asked = batch(condition)
    motions = glide.motions(asked)
    assert [len(joints) for joints in motions] == asked.n_frames.tolist()
    for joints, initial in zip(motions, asked.initial_joints):
        np.testing.assert_allclose(joints[0], initial, atol=1e-6)


def test_a_goal_within_reach_is_met_by_a_wrist_and_no_bone_changes(glide, batch):
    asked = batch(Condition.GOAL_LOCATION)
    # behind the body and before it, low and high
    goals = STANDING[WRISTS[0]] + np.linspace([-1.5, -0.2, -2.0], [2.5, 0.6, 3.0], len(asked))
    asked = dataclasses.replace(
        asked, goal_location=goals, initial_joints=np.tile(STANDING.astype(np.float32), (len(asked), 1, 1))
    )
    for joints, goal in zip(glide.motions(asked), goals):
        assert min(np.linalg.norm(joints[-1, wrist] - goal) for wrist in WRISTS) < 0.01
        lengths = bone_lengths(joints.astype(np.float64))
        np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], lengths.shape), atol=1e-5)


def test_the_goal_pose_is_met_exactly_and_bones_keep_their_lengths_on_the_way(glide, batch):
    asked = batch(Condition.GOAL_POSE)
    turned = STANDING[:, [2, 1, 0]] * (1.0, 1.0, -1.0) + (1.0, 0.0, 2.0)  # faces +X elsewhere
    asked = dataclasses.replace(
        asked,
        goal_joints=np.tile(turned.astype(np.float32), (len(asked), 1, 1)),
        initial_joints=np.tile(STANDING.astype(np.float32), (len(asked), 1, 1)),
    )
    for joints in glide.motions(asked):
        np.testing.assert_allclose(joints[-1], turned, atol=1e-6)
        np.testing.assert_allclose(
            bone_lengths(joints.astype(float)), bone_lengths(STANDING) + 0 * joints[:, 1:, 0], atol=1e-5
        )


@pytest.mark.parametrize("condition", GOALS)
def test_motions_depend_on_the_row_alone(glide, batch, condition):
    whole = glide.motions(batch(condition))
    rows = [7, 2, 5]
    for row, joints in zip(rows, glide.motions(batch(condition, rows))):
        assert np.array_equal(whole[row], joints)
    other_seed = glide.motions(batch(condition, rows, seed=1))
    assert not any(np.array_equal(whole[row], joints) for row, joints in zip(rows, other_seed))


@pytest.mark.parametrize("condition", GOALS)
def test_the_oldest_python_at_hand_gives_the_same_bytes(glide, batch, condition, tmp_path):
    version, python = older_python()
    assert version >= (3, 8)
    with ByHand([python, str(EXAMPLES / "glide.py")], tmp_path / "log") as old:
        assert _bytes(old.motions(batch(condition))) == _bytes(glide.motions(batch(condition)))


@pytest.mark.parametrize("condition", GOALS)
def test_javascript_gives_the_same_motions_and_scores(glide, batch, condition, table, tmp_path):
    with ByHand(javascript(tmp_path), tmp_path / "log") as other:
        assert other.introduction == glide.introduction
        asked = batch(condition)
        from_javascript, from_python = other.motions(asked), glide.motions(asked)
    assert _bytes(from_javascript) == _bytes(from_python)
    first, second = (
        _scores(table, asked.opaque_id, motions, tmp_path / name)
        for name, motions in (("js", from_javascript), ("python", from_python))
    )
    assert len(first) > 50
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_by_command_by_description_behind_a_fence_and_offline_it_scores_alike(table, glide, tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    command = f'cmd:"{sys.executable}" "{EXAMPLES / "glide.py"}"'
    runs = {"command": (command, False), "description": (str(EXAMPLES / "glide.toml"), False), "fence": (command, True)}
    found = {}
    for name, (method, isolate) in runs.items():
        request = RunRequest(
            method=method,
            data=(table.folder,),
            condition=Condition.GOAL_LOCATION,
            isolate=isolate,
            batch_size=4,
            out=tmp_path / name,
        )
        report = run_method(request)
        assert (report.folder.record.method.name, report.folder.record.method.version) == ("glide", "1.0")
        found[name] = (report.folder.path / "synthetic-adt/scores.parquet").read_bytes()
    assert found["command"] == found["description"] == found["fence"]
    asked = tmp_path / "asked.npz"
    export_conditions(ExportRequest(data=(table.folder,), condition=Condition.GOAL_LOCATION, out=asked))
    ((_, rows),) = batches_of(read_conditions_file(asked))
    offline = _scores(table, rows.opaque_id, glide.motions(rows), tmp_path / "offline")
    np.testing.assert_array_equal(offline, _values(tmp_path / "command"))


def _bytes(motions):
    return b"".join(joints.tobytes() for joints in motions)


def _scores(table, ids, motions, folder):
    """Every score, from a predictions file by opaque id."""
    kind = pa.list_(pa.list_(pa.float32(), 66))
    rows = {"opaque_id": ids, "joints": pa.array([m.reshape(-1, 66).tolist() for m in motions], kind)}
    folder.mkdir()
    pq.write_table(pa.table(rows), folder / "p.parquet")
    score_predictions(ScoreRequest(predictions=folder / "p.parquet", data=(table.folder,), out=folder / "scores"))
    return _values(folder / "scores")


def _values(folder):
    scores = read_scores(folder / "synthetic-adt/scores.parquet").sort_by(
        [("sequence_id", "ascending"), ("metric", "ascending")]
    )
    return scores["value"].to_numpy(zero_copy_only=False).astype(np.float64)


def _conversation(command: list[str], lines: bytes) -> tuple[list[dict], bytes, int]:
    """Headers answered without payloads, the log, and the exit status once stdin is closed."""
    done = subprocess.run(command, input=lines, capture_output=True, timeout=60)
    return [json.loads(line) for line in io.BytesIO(done.stdout)], done.stderr, done.returncode


def _hello(**changes) -> bytes:
    hello = {"message": "hello", "wire": 1, "prbench": "0", "device": "cpu", "threads": 1, "options": {}}
    return json.dumps({**hello, "weights": None, **changes}).encode() + b"\n"


@pytest.fixture(params=["python", "javascript"])
def command(request, tmp_path):
    return [sys.executable, str(EXAMPLES / "glide.py")] if request.param == "python" else javascript(tmp_path)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"wire": 2}, "wire protocol 1"),
        ({"weights": "w.npz"}, "no weights"),
        ({"options": {"speed": "2"}}, "unknown option 'speed'"),
        ({"options": {"stop-before": "near"}}, "near"),
    ],
)
def test_settings_that_it_does_not_know_are_refused_before_any_batch(command, changes, word):
    answers, _, status = _conversation(command, _hello(**changes))
    assert [answer["message"] for answer in answers] == ["error"]
    assert word in answers[0]["text"]
    assert status == 0


def test_a_batch_that_fails_is_told_and_the_next_message_awaited(command):
    generate = b'{"message": "generate", "batch": 0, "condition": "goal-loc", "rows": 1, "fps": 20, "bytes": 4}\nnope'
    unknown = b'{"message": "stretch", "later": true}\n'
    answers, log, status = _conversation(command, _hello() + unknown + generate + generate)
    assert [answer["message"] for answer in answers] == ["hello", "error", "error"]
    assert answers[1]["batch"] == 0
    assert answers[1]["out_of_memory"] is False
    assert log
    assert status == 0


def test_a_request_that_comes_in_pieces_is_read_whole(command, tmp_path):
    shown = Exchange.shown()
    with (tmp_path / "answer").open("wb") as answer:
        program = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=answer)
        assert program.stdin is not None
        for start in range(0, len(shown.stdin), 500):
            program.stdin.write(shown.stdin[start : start + 500])
            program.stdin.flush()
            time.sleep(0.01)
        program.stdin.close()
        assert program.wait(20) == 0
    assert decoded((tmp_path / "answer").read_bytes()) == decoded(shown.stdout)


def test_requests_and_answers_larger_than_a_pipe_go_through(command, batch, tmp_path):
    rows = list(range(10)) * 20
    asked = batch(Condition.GOAL_LOCATION, rows)
    asked = dataclasses.replace(
        asked, n_frames=np.full(len(rows), 241), opaque_id=tuple(f"{place:064x}" for place in range(len(rows)))
    )
    with ByHand(command, tmp_path / "log") as program:
        motions = program.motions(asked)
    assert len(program.sent[-1]) > 100_000
    assert len(program.got[-1]) > 10_000_000
    assert all(joints.shape == (241, 22, 3) for joints in motions)


def test_what_a_library_prints_ends_in_the_log(tmp_path):
    noisy = SOURCE.replace(
        "    hello, _ = read_message(source)\n",
        "    hello, _ = read_message(source)\n    print('greetings')\n    os.system('echo from a child')\n",
    )
    assert noisy != SOURCE
    (tmp_path / "noisy.py").write_text(noisy, encoding="utf-8")
    answers, log, status = _conversation([sys.executable, str(tmp_path / "noisy.py")], _hello())
    assert [answer["message"] for answer in answers] == ["hello"]
    assert b"greetings" in log
    assert b"from a child" in log
    assert status == 0
