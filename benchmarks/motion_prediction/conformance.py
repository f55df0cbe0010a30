"""What is only about predictors of motion prediction: their windows, the futures that they answer, and their checks."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from prbench.checking.conformance import subject as subjects
from prbench.checking.conformance.checks import body, form, reproducibility
from prbench.checking.conformance.findings import CheckRequest, Finding, Remedy, check, failed, passed, skipped, warning
from prbench.checking.conformance.session import Judge
from prbench.checking.conformance.subject import STATE_SEED, Answer, MethodSubject
from prbench.errors import PrbenchError, UsageError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.loading import LoadedMethod, MethodSpec, unload_method
from prbench.harness.methods.motions import told
from prbench.harness.methods.process import computing_threads
from prbench.protocol.manifests import find_benchmark
from prbench.sequences.table import by_share
from prbench_benchmarks.motion_prediction.anchored import build_anchored_windows
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch, Predictor, require_futures
from prbench_benchmarks.motion_prediction.benchmark import learns_from_table
from prbench_benchmarks.motion_prediction.metrics import bone_error, first_frame_jump
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import FILE_NAME, Run, Window, WindowsTable, write_windows

BENCHMARK = "motion-prediction"
WINDOWS = 12  # Asked about, unless a predictor is slow.
# The condition that most checks use is the first of these that works.
RICHEST_FIRST = (Condition.POSE_GAZE, Condition.POSE_HEAD, Condition.POSE)
# Training windows; more than the benchmark's samples, so that a predictor may answer with one of them each.
_TO_LEARN_FROM = 60
_BLIND = "windows-without-futures"
_FEW = 5
_FRAMES = ("joints", "joints_valid", "gaze", "gaze_valid", "head_direction")  # of a run, one value a frame
_OTHER_KEYS = 7919
_FURTHER_KEYS = 104_729  # Added to the keys of windows for other ones.


@dataclass(frozen=True)
class AskedWindows:
    """Test windows, each a run of its own, and training runs behind them.

    Attributes:
        blind: A copy of the table with NaN in every frame after the observed ones of the test windows.
    """

    table: WindowsTable
    blind: WindowsTable


def synthetic_windows(folder: Path) -> AskedWindows:
    """Return windows of synthetic people; the first process makes and keeps them, later ones read the same numbers.

    Args:
        folder: An empty folder that this check alone uses.
    """
    from prbench.checking.conformance.cases import RECORDINGS, write_synthetic_table

    anchored = folder / "anchored"
    if not (anchored / FILE_NAME).is_file():
        # More people to learn from than for motions, because a predictor may answer with one training window each.
        table = write_synthetic_table(folder / "sequences", (*RECORDINGS, 3, 4, 5, 6, 7, 8, 9))
        build_anchored_windows(table, anchored, only=("prime",))
    return windows_of_table(anchored, folder)


def windows_of_table(data: Path, folder: Path) -> AskedWindows:
    """Return twelve test windows of a table, chosen as ``--limit`` does, with some of its training windows.

    Args:
        data: Folder of the table.
        folder: An empty folder that this check alone uses.

    Raises:
        TableError: if there is no such table.
        UsageError: if it has no test windows.
    """
    whole = folder / "windows"
    blind = folder / _BLIND
    if not (blind / FILE_NAME).is_file():  # the blind one is written last
        table = WindowsTable.open(data)
        observed = table.info.observed_frames
        length = observed + table.info.future_frames
        places = table.chosen(split="test")
        ids = table.windows["window_id"].take(places).to_pylist()
        recordings = table.runs["recording_id"].take(table.windows["row"].take(places)).to_pylist()
        wanted = set(by_share(ids, recordings)[:WINDOWS])
        rows = [row for row in table.windows.take(places).to_pylist() if row["window_id"] in wanted]
        runs = dict(table.iterate_runs(row["row"] for row in rows))
        # Each window as a run of its own, of which nothing else is known; goals and events are left out.
        asked = []
        for row in rows:
            run = runs[row["row"]]
            part = slice(row["start"], min(row["start"] + length, run.n_frames))
            frames = {name: getattr(run, name)[part].copy() for name in _FRAMES}
            start_time = run.start_time + part.start / run.fps
            alone = replace(run, run_id=row["window_id"], start_time=start_time, **frames)
            looking = int(alone.gaze_valid[:observed].sum())
            asked.append(replace(alone, windows=(Window(0, looking, row["n_scored"]),)))
        train: list[Run] = []
        with contextlib.suppress(UsageError):  # the table has no such split
            train = list(table.runs_of(table.training()[:_TO_LEARN_FROM]))
        write_windows(whole, table.info, [*asked, *train])
        for each in asked:
            for values in (each.joints, each.gaze, each.head_direction):
                values[observed:] = np.nan
        with np.errstate(invalid="ignore"):  # digests of numbers that are none
            write_windows(blind, table.info, [*asked, *train])
    return AskedWindows(WindowsTable.open(whole), WindowsTable.open(blind))


class PredictorSubject(MethodSubject):
    """A predictor, and the windows that it is asked about.

    Args:
        spec: How to make it.
        cases: What it is asked about.
        folder: An empty folder that this check alone uses.
    """

    case = "window"
    things = "futures"
    asks = "predicts"
    shape = "(windows, samples, frames, joints, 3)"
    shape_remedy = Remedy(
        "Return prbench_benchmarks.motion_prediction.batch.Futures(joints=joints): joints is an array"
        " (windows, samples, frames, joints, 3) with"
        " n_samples futures of batch.n_future frames each, without the observed ones.",
        "Send one row a window: its opaque_id, and joints with n_samples times n_future times the numbers of a pose,"
        " sample by sample and frame by frame, without the observed frames (docs/wire-protocol.md).",
    )
    own_generators = Remedy(
        "Draw from one generator a sample: prbench_benchmarks.motion_prediction.batch.sample_generator(seed,"
        " batch.key[row], k), or"
        " torch.Generator().manual_seed(…) of a number drawn from it.",
        "Draw from one generator a sample, made of seed, the key of its row and the number k of the sample alone"
        " (numpy.random.default_rng([seed, key, k])).",
    )
    own_row = (
        "Every row is complete in itself: draw from seed, its own key and k, and let no statistic (batch normalisation,"
        " a common stopping rule) run over rows."
    )

    def __init__(self, spec: MethodSpec, cases: AskedWindows, folder: Path) -> None:
        super().__init__(spec, folder)
        self.cases = cases
        self._as_given = spec

    @property
    def many_samples(self) -> int:
        """The benchmark's usual number of futures."""
        return find_benchmark(BENCHMARK).samples

    @property
    def samples(self) -> int:
        """Futures that most checks ask for: few, or the benchmark's usual number of those that are one design."""
        return self.many_samples if self.declared.one_design else _FEW

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The conditions that it declares and the windows can be shown under, the richest first."""
        shown = [each for each in RICHEST_FIRST if each is not Condition.POSE_GAZE or self.cases.table.info.has_gaze]
        return tuple(condition for condition in shown if condition in self.declared.conditions)

    @property
    def n_cases(self) -> int:
        """Number of windows."""
        return len(self.cases.table.chosen(split="test"))

    def is_misshapen(self, answer: Answer) -> bool:
        """See :meth:`MethodSubject.is_misshapen`."""
        if answer.motions is not None:
            return False
        if subjects.program_misshaped(answer) or not isinstance(answer.returned, Futures):
            return True
        batch = answer.batch
        expected = (len(batch), answer.n_samples, batch.n_future, len(batch.joint_names), 3)
        return np.shape(answer.returned.joints) != expected

    def learns(self, loaded: LoadedMethod) -> bool:
        """Return True if a run would fit it to the training windows."""
        return learns_from_table(loaded.adapter)

    def fitted_spec(self) -> MethodSpec:
        """Fit it as a run does: it is shown the training windows of the table."""
        return load_benchmark(BENCHMARK).fitted(self._as_given, self.cases.table, "test")

    def _observed(self, condition: Condition, table: WindowsTable, rows: Sequence[int]) -> ObservedBatch:
        """Return some windows as a run shows them."""
        places = table.chosen(split="test")
        frame = load_prediction_protocol().evaluation.frame
        batch, _ = next(table.batches(condition, places, frame=frame, size=len(places)))
        return batch.chosen(rows)

    def batch(self, rows: Sequence[int], condition: Condition, *, sample: int = 0) -> ObservedBatch:
        """See :meth:`MethodSubject.batch`; another sample has other keys."""
        return self.with_keys(self._observed(condition, self.cases.table, rows), sample * _OTHER_KEYS)

    @staticmethod
    def with_keys(batch: ObservedBatch, added: int) -> ObservedBatch:
        """Return the batch with other keys."""
        return replace(batch, key=tuple((key + added) % 2**63 for key in batch.key))

    def rows_of(self, batch: ObservedBatch, rows: Sequence[int]) -> ObservedBatch:
        """See :meth:`MethodSubject.rows_of`."""
        return batch.chosen(rows)

    def nudged(self, batch: ObservedBatch, by: np.float32) -> ObservedBatch:
        """Move the observed poses."""
        return replace(batch, observed_joints=batch.observed_joints + by)

    def ask(
        self, batch: ObservedBatch, *, seed: int = 0, state_seed: int = STATE_SEED, n_samples: int | None = None
    ) -> Answer:
        """See :meth:`MethodSubject.ask`; ``n_samples`` is the number of futures, :attr:`samples` by default."""
        return self._asked(self.adapter, batch, n_samples or self.samples, seed=seed, state_seed=state_seed)

    def ask_without_futures(self, condition: Condition, rows: Sequence[int]) -> Answer:
        """Make the predictor anew where no future is to be found, fit it there if it learns, and ask it.

        Args:
            condition: What it knows.
            rows: Numbers of the windows.
        """
        samples = self.samples
        spec = self._as_given
        learns = self.learns(self.loaded) and self.spec.weights is None
        # Whatever the predictor has kept from before is gone with it.
        unload_method()
        if learns:
            spec = load_benchmark(BENCHMARK).fitted(spec, self.cases.blind, "test")
        answer = self._asked(spec.load().adapter, self._observed(condition, self.cases.blind, rows), samples)
        unload_method()
        vars(self).pop("loaded", None)
        return answer

    def _asked(
        self, predictor: Predictor, batch: ObservedBatch, n_samples: int, *, seed: int = 0, state_seed: int = STATE_SEED
    ) -> Answer:
        """Call the predictor as a run does; whatever it raises becomes part of the answer."""
        of_one = "1 window" if len(batch) == 1 else f"{len(batch)} windows"
        self.asking(f"while it predicted {n_samples} futures of {of_one} under {batch.condition.value}")
        returned: object = None
        motions = None
        answered = False
        error = ""
        drew: tuple[str, ...] = ()
        started = time.perf_counter()
        try:
            with computing_threads(self.spec.threads), subjects.generators_set_to(state_seed):
                before = subjects.generator_states()
                try:
                    returned = predictor.predict(batch, n_samples=n_samples, seed=seed)
                    answered = True
                finally:
                    drew = subjects.generators_touched(before)
            futures = require_futures(returned, batch, n_samples, predictor=str(getattr(predictor, "name", "?")))
            motions = Futures(joints=np.asarray(futures.joints, dtype=np.float32))
        except PrbenchError as raised:
            error = str(raised)
        except (Exception, SystemExit) as raised:
            error = f"it raised {told(raised)}."
        seconds = time.perf_counter() - started
        self.drew_from.update(drew)
        return Answer(batch, motions, error, returned, answered, seconds, drew_from=drew, n_samples=n_samples)


_PREDICT = Remedy(
    "Run predict() on this batch and repair what it raises; a predictor may only refuse options and weights.",
    "Repair what keeps the program from answering 'predict' with 'futures': its log (stderr) is shown with the error.",
)
_PAST = "Leave the observed frames away: the first frame of a future is the one after the last observed frame."
_NO_FUTURE = (
    "A predictor learns from what it is given alone: the training windows in fit(), the observed frames in predict()."
    " Open no table of windows, and take nothing from the objects around the batch."
)
_PREFIX = (
    "Draw sample k from a generator of its own, so that it does not know how many are asked for. Where the K samples of"
    " a window are one design, say so: one_design = True; then fewer samples have no scores."
)


@check("predicts", "it predicts under every condition that it declares", needs=("load",))
def predicts(subject: PredictorSubject) -> Iterator[Finding]:
    """Predict under each declared condition; none may raise."""
    if subject.conditions:
        yield from form.answered_everywhere(subject, _PREDICT, said=f"{subject.samples} futures of each window")
    else:
        yield skipped("these windows have no gaze, without which it does not predict.")


@check("past", "futures are no copy of the past", needs=("load", "shapes", "dtype", "finite"))
def past(subject: PredictorSubject) -> Iterator[Finding]:
    """Look for futures that begin with the observed frames."""
    answers = {condition: subject.standard(condition) for condition in subject.conditions}
    answers = {condition: answer for condition, answer in answers.items() if answer.answered}
    said = "none begins with the observed frames"
    yield from form.by_condition(subject, answers, lambda answer: "begin with the" in answer.error, _PAST, said=said)


@check("firewall", "without futures in the table every prediction stays the same", of_motions=True)
def firewall(subject: PredictorSubject) -> Iterator[Finding]:
    """Make it anew where all frames after the observed ones are NaN, and compare every byte."""
    for condition in subject.working:
        usual = subject.standard(condition)
        blind = subject.ask_without_futures(condition, subject.rows)
        if blind.motions is None:
            yield failed(f"under {condition.value}, with NaN in all future frames: {blind.error}", _NO_FUTURE)
            return
        if subjects.same_bytes(usual, blind):
            continue
        again = subject.ask(usual.batch)
        moved = float(subjects.largest_changes(usual, blind).max())
        if again.motions is not None and not subjects.same_bytes(usual, again) and moved <= subjects.TOLERANCE:
            found = f"joints moved by up to {moved:.1e} m, as they do when it is asked twice."
            remedy = "That is rounding, which differs from call to call."
            yield warning(f"under {condition.value}: {found}", remedy, change_m=moved)
            return
        found = f"with NaN in all future frames, joints moved by up to {subjects.metres(moved)}."
        yield failed(f"under {condition.value}, {found}", _NO_FUTURE, change_m=moved)
        return
    names = ", ".join(each.value for each in subject.working)
    yield passed(f"with NaN in all future frames the same bytes, under {names}.")


@check("seed", "seed, key and number of the sample decide what is drawn", needs=("determinism",), of_motions=True)
def seed(subject: PredictorSubject) -> Iterator[Finding]:
    """Ask with another seed, and with other keys."""
    first = subject.standard(subject.main)
    others = {
        "another seed": subject.ask(first.batch, seed=1),
        "other keys": subject.ask(subject.with_keys(first.batch, _FURTHER_KEYS)),
    }
    for name, answer in others.items():
        if answer.motions is None:
            yield failed(f"with {name}: {answer.error}", subject.own_generators)
            return
    changes = {name: subjects.largest_changes(first, answer) for name, answer in others.items()}
    if not any(change.any() for change in changes.values()):
        yield passed("neither seed nor keys change anything: it draws nothing.")
        return
    for name, change in changes.items():
        if not change.all():
            still = int((change == 0).sum())
            yield failed(f"with {name}, {still} of {len(change)} windows stayed the same.", subject.own_generators)
            return
    joints = first.motions.joints
    if first.n_samples > 1 and bool((joints == joints[:, :1]).all()):
        yield warning(
            f"the {first.n_samples} futures of each window are the same, although the seed changes them.",
            subject.own_generators,
        )
        return
    moved = float(changes["another seed"].max())
    yield passed(f"another seed or key moves joints, by up to {subjects.metres(moved)}.", change_m=moved)


@check("samples", "fewer samples are a prefix of more", needs=("determinism", "global-random", "seed"), of_motions=True)
def samples(subject: PredictorSubject) -> Iterator[Finding]:
    """Ask for one future, for five and for fifty of each window."""
    if subject.declared.one_design:
        yield skipped(f"its {subject.samples} samples are one design, as it declares; fewer have no scores.")
        return
    first = subject.standard(subject.main)
    worst = 0.0
    for number in (1, subject.many_samples):
        other = subject.ask(first.batch, n_samples=number)
        if other.motions is None:
            yield failed(f"asked for {number} futures of each window: {other.error}", _PREFIX)
            return
        shared = min(number, first.n_samples)
        apart = first.motions.joints[:, :shared] - other.motions.joints[:, :shared]
        worst = max(worst, float(np.linalg.norm(apart, axis=-1).max()))
    asked = f"1, {first.n_samples} and {subject.many_samples} futures of each window"
    if worst == 0.0:
        yield passed(f"{asked} begin with the same bytes.", change_m=worst)
    elif worst <= subjects.TOLERANCE:
        yield warning(f"{asked} begin alike but for {worst:.1e} m.", "That is rounding.", change_m=worst)
    else:
        yield failed(f"{asked}: those that all share moved by up to {subjects.metres(worst)}.", _PREFIX, change_m=worst)


@check("first-frame", "futures go on where the observed frames end", of_motions=True)
def first_frame(subject: PredictorSubject) -> Iterator[Finding]:
    """Measure the jump from the last observed to the first predicted frame, median over windows."""
    answer = subject.standard(subject.main)
    jump = float(np.median(first_frame_jump(answer.motions.joints, answer.batch.observed_joints[:, -1])))
    text = f"{subjects.metres(jump)} from the last observed to the first predicted frame (median)."
    remedy = "Answer in metres, Y up, in the frame of the observed joints: a body cannot move so far in a frame."
    yield _judged(jump, 0.1, 1.0, text, remedy, jump_m=jump)


@check("bone-lengths", "one body, of one size", of_motions=True)
def bones(subject: PredictorSubject) -> Iterator[Finding]:
    """Compare bone lengths with those of the last observed pose, median over windows."""
    answer = subject.standard(subject.main)
    joints = subject.cases.table.joints
    errors = bone_error(answer.motions.joints, answer.batch.observed_joints[:, -1], joints.bones)
    error = float(np.median(errors))
    text = f"bones differ from those of the last observed pose by {error:.1f} % (median)."
    remedy = "Look at the order of joints (batch.joint_names), at units, and at averages over turned poses."
    yield _judged(error, 10.0, 50.0, text, remedy, bone_error_percent=error)


def _judged(value: float, warn: float, fail: float, text: str, remedy: str, **numbers: float) -> Finding:
    if value <= warn:
        return passed(text, **numbers)
    return (failed if value > fail else warning)(text, remedy, **numbers)


# In the order in which they are made; those that ask for no motions are the checks of any method.
_OF_FORM = (predicts, form.shapes, form.dtype, form.finite, past)
_ASKED_AGAIN = (reproducibility.determinism, reproducibility.global_random)
_OF_DRAWING = (seed, samples, reproducibility.single_row, reproducibility.batch)
# The last one runs in a process of its own.
_LAST = (first_frame, bones, *body.RESOURCES, reproducibility.process)
CHECKS = (*form.LOADING, *_OF_FORM, *_ASKED_AGAIN, firewall, *_OF_DRAWING, *_LAST)


def _futures(spec: MethodSpec, request: CheckRequest, folder: Path) -> PredictorSubject:
    cases = synthetic_windows(folder) if request.data is None else windows_of_table(request.data, folder)
    return PredictorSubject(spec, cases, folder)


def judge() -> Judge:
    """Return the checks of predictors, for :func:`prbench.checking.conformance.session.judge_of`."""
    return Judge(CHECKS, _futures, lambda data: WindowsTable.open(data).chosen(split="test"))
