"""What is only about predictors of motion prediction: their windows, the futures that they answer, and their checks."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from prbench.checking.conformance.checks import body, form, reproducibility
from prbench.checking.conformance.findings import CheckRequest, Finding, Remedy, check, failed, passed, skipped, warning
from prbench.checking.conformance.session import Judge
from prbench.checking.conformance.subject import (
    STATE_SEED,
    TOLERANCE,
    Answer,
    MethodSubject,
    generator_states,
    generators_set_to,
    generators_touched,
    largest_changes,
    metres,
    same_bytes,
)
from prbench.errors import PrbenchError, UsageError
from prbench.geometry.skeleton import head_forward
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.loading import LoadedMethod, MethodSpec, unload_method
from prbench.harness.methods.motions import told
from prbench.harness.methods.process import computing_threads
from prbench.harness.methods.remote import RemoteMethod
from prbench.protocol.manifests import find_benchmark
from prbench.sequences.table import by_share
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch, Predictor, require_futures
from prbench_benchmarks.motion_prediction.joint_sets import SMPL22
from prbench_benchmarks.motion_prediction.metrics import bone_error, first_frame_jump
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import (
    FILE_NAME,
    SCHEMA_VERSION,
    CutRun,
    Run,
    Window,
    WindowsInfo,
    WindowsTable,
)
from prbench_benchmarks.motion_prediction.table import write_windows as write
from prbench_benchmarks.motion_prediction.windows import sliding_windows


def ask_predictor(
    predictor: Predictor, batch: ObservedBatch, *, n_samples: int, seed: int, state_seed: int, threads: int
) -> Answer:
    """Call the predictor as a run does; whatever it raises becomes part of the answer.

    Args:
        predictor: The predictor.
        batch: What it is asked.
        n_samples: Futures of each window.
        seed: The run's seed.
        state_seed: Of the global generators.
        threads: Of NumPy's and torch's libraries.
    """
    returned: object = None
    motions = None
    answered = False
    error = ""
    drew: tuple[str, ...] = ()
    started = time.perf_counter()
    try:
        with computing_threads(threads), generators_set_to(state_seed):
            before = generator_states()
            try:
                returned = predictor.predict(batch, n_samples=n_samples, seed=seed)
                answered = True
            finally:
                drew = generators_touched(before)
        futures = require_futures(returned, batch, n_samples, predictor=str(getattr(predictor, "name", "?")))
        motions = Futures(joints=np.asarray(futures.joints, dtype=np.float32))
    except PrbenchError as raised:
        error = str(raised)
    except (Exception, SystemExit) as raised:
        error = f"it raised {told(raised)}."
    seconds = time.perf_counter() - started
    return Answer(batch, motions, error, returned, answered, seconds, drew_from=drew, n_samples=n_samples)


if TYPE_CHECKING:
    from prbench.synthetic.performance import Performance

WINDOWS = 12
"""Asked about, unless a predictor is slow."""
_TO_LEARN_FROM = 60
"""Training windows; more than the benchmark's samples, so that a predictor may answer with one of them each."""
_TABLE = "windows"
_BLIND = "windows-without-futures"
_PRESET = "adt"
_SEED = 2024  # differs from that of embedded people, whom a predictor may have learnt from
_OF_ONE = 6  # windows a recording, so that several people are seen


@dataclass(frozen=True)
class AskedWindows:
    """Test windows, each a run of its own, and training runs behind them."""

    table: WindowsTable
    blind: WindowsTable
    """The same table, with NaN in every frame after the observed ones of the test windows."""


def synthetic_windows(folder: Path) -> AskedWindows:
    """Return windows of synthetic people; the first process makes and keeps them, later ones read the same numbers.

    Args:
        folder: Of this check alone.
    """
    if not _is_kept(folder):
        runs = _performed("train")
        rules = load_prediction_protocol().windows
        found: list[CutRun] = []
        for _, run in runs:
            found.append(CutRun(run, sliding_windows(run, np.zeros(len(run), dtype=bool), rules)))
            if sum(len(each.windows) for each in found) >= _TO_LEARN_FROM:
                break
        train = found
        _keep(folder, _info(), _test_windows(), train)
    return _kept(folder)


def windows_of_table(data: Path, folder: Path) -> AskedWindows:
    """Return twelve test windows of a table, chosen as ``--limit`` does, with some of its training windows.

    Args:
        data: Folder of the table.
        folder: Of this check alone.

    Raises:
        TableError: if there is no such table.
        UsageError: if it has no test windows.
    """
    if _is_kept(folder):
        return _kept(folder)
    table = WindowsTable.open(data)
    places = table.chosen(split="test")
    rows = table.windows["row"].take(places)
    ids = table.windows["window_id"].take(places).to_pylist()
    wanted = set(by_share(ids, table.runs["recording_id"].take(rows).to_pylist())[:WINDOWS])
    chosen = {name: int(place) for name, place in zip(ids, places, strict=True) if name in wanted}
    # Each window as a run of its own, of which nothing else is known; goals and events are left out.
    info = table.info
    length = info.observed_frames + info.future_frames
    places = np.array(sorted(chosen.values()))
    names = {place: name for name, place in chosen.items()}
    row_of = {int(place): int(table.windows["row"][int(place)].as_py()) for place in places}
    runs = dict(table.iterate_runs(row_of.values()))
    cut = []
    for place in places.tolist():
        run = runs[row_of[place]]
        start = int(table.windows["start"][place].as_py())
        n_scored = int(table.windows["n_scored"][place].as_py())
        alone = _part(run, names[place], start, min(start + length, len(run)))
        looking = int(alone.gaze_valid[: info.observed_frames].sum())
        cut.append(CutRun(alone, (Window(0, looking, n_scored),)))
    _keep(folder, table.info, cut, _training_runs(table))
    return _kept(folder)


def require_windows(data: Path) -> None:
    """Refuse a folder without test windows.

    Raises:
        TableError: if there is no table of windows.
        UsageError: if it has no test windows.
    """
    WindowsTable.open(data).chosen(split="test")


def _is_kept(folder: Path) -> bool:
    return (folder / _BLIND / FILE_NAME).is_file()


def _kept(folder: Path) -> AskedWindows:
    return AskedWindows(WindowsTable.open(folder / _TABLE), WindowsTable.open(folder / _BLIND))


def _keep(folder: Path, info: WindowsInfo, test: list[CutRun], train: list[CutRun]) -> None:
    """Write both tables, the blind one last, by which later processes know that both are there."""
    observed = info.observed_frames
    if not test:
        raise UsageError("expected windows of the test split to ask about, found none.")
    write(folder / _TABLE, info, [*test, *train])
    with np.errstate(invalid="ignore"):  # digests of numbers that are none
        write(folder / _BLIND, info, [*(CutRun(_blinded(each.run, observed), each.windows) for each in test), *train])


def _blinded(run: Run, observed: int) -> Run:
    changed = {}
    for name in ("joints", "gaze", "head_direction"):
        values = getattr(run, name).copy()
        values[observed:] = np.nan
        changed[name] = values
    return replace(run, **changed)


def _training_runs(table: WindowsTable) -> list[CutRun]:
    """Runs of the training split until there are enough windows; none where the table has no such split."""
    try:
        places = table.chosen(split="train")[:_TO_LEARN_FROM]
    except UsageError:
        return []
    rows = table.windows.take(places).to_pylist()
    runs = dict(table.iterate_runs({row["row"] for row in rows}))
    return [CutRun(run, tuple(Window.of(row) for row in rows if row["row"] == number)) for number, run in runs.items()]


def _part(run: Run, name: str, first: int, end: int) -> Run:
    frames = {
        field: getattr(run, field)[first:end]
        for field in ("joints", "joints_valid", "gaze", "gaze_valid", "head_direction")
    }
    return replace(run, run_id=name, start_time=run.start_time + first / run.fps, **frames)


def _test_windows() -> list[CutRun]:
    """Half a second up to the prime, and the reach behind it."""
    from prbench.synthetic.performance import true_clips

    rules = load_prediction_protocol().windows
    length = rules.observed_frames + rules.future_frames
    cut: list[CutRun] = []
    for performance, run in _performed("test"):
        primes = [clip.event.prime_time for clip in true_clips(performance)]
        starts = [round((time or 0.0) * rules.fps) - rules.observed_frames for time in primes]
        for start in [each for each in starts if 0 <= each < len(run) - length][:_OF_ONE]:
            alone = _part(run, f"{run.run_id}/{start}", start, start + length)
            cut.append(CutRun(alone, (Window(0, rules.observed_frames, rules.future_frames),)))
        if len(cut) >= WINDOWS:
            return cut[:WINDOWS]
    raise AssertionError("synthetic people do not end")


def _performed(split: str) -> Iterator[tuple[Performance, Run]]:
    """Recordings of synthetic people of a split; no person and no room is in two of them."""
    from prbench.synthetic.people.perform import name_of_recording, perform
    from prbench.synthetic.people.world import Source, assign

    rules = load_prediction_protocol().windows
    source = Source(_SEED, _PRESET, "default")
    for index in count():
        if assign(source, index).split != split:
            continue
        performance = perform(_PRESET, seed=_SEED, index=index, rate=2 * rules.fps, provocations={})
        joints = performance.joints[::2]
        name = name_of_recording(_PRESET, _SEED, index)
        yield (
            performance,
            Run(
                run_id=name,
                recording_id=name,
                participant_id=performance.person.participant_id,
                split=split,
                published_split="",
                segment="",
                pose_source="invented",
                fps=rules.fps,
                start_time=0.0,
                joints=joints,
                joints_valid=np.ones(len(joints), dtype=bool),
                gaze=performance.gaze[::2],
                gaze_valid=np.ones(len(joints), dtype=bool),
                head_direction=head_forward(joints, performance.person.neck_tilt_deg)[0],
            ),
        )


def _info() -> WindowsInfo:
    protocol = load_prediction_protocol()
    rules = protocol.windows
    unknown = ("prbench_version", "manifest_digest", "input_digest", "identity_digest", "content_digest", "homepage")
    return WindowsInfo(
        **dict.fromkeys((*unknown, "citation"), ""),
        schema_version=SCHEMA_VERSION,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        dataset="synthetic-conformance",
        title="Invented people (conformance check)",
        synthetic=True,
        options={},
        outcomes={},
        quarantine=(),
        licence="none needed: invented",
        redistribution="yes",
        fps=rules.fps,
        observed_frames=rules.observed_frames,
        future_frames=rules.future_frames,
        fewest_gaze_frames=rules.fewest_gaze_frames,
        joint_set=SMPL22.name,
        has_gaze=False,
        estimated_bodies=False,
        participants=0,
        recordings=0,
        runs=0,
        frames=0,
    )


BENCHMARK = "motion-prediction"
RICHEST_FIRST = (Condition.POSE_GAZE, Condition.POSE_HEAD, Condition.POSE)
"""The condition that most checks use is the first of these that works."""
_FEW = 5
_OTHER_KEYS = 7919
"""Added to the keys of windows for other ones."""


class PredictorSubject(MethodSubject):
    """A predictor, and the windows that it is asked about.

    Args:
        spec: How to make it.
        cases: What it is asked about.
        folder: Of this check.
    """

    case = "window"
    asks = "predicts"
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
        self._observed: dict[Condition, ObservedBatch] = {}

    @property
    def samples(self) -> int:
        """Futures that most checks ask for: few, or the benchmark's usual number of those that are one design."""
        return find_benchmark(BENCHMARK).samples if self.declared.one_design else _FEW

    @property
    def many_samples(self) -> int:
        """The benchmark's usual number of futures."""
        return find_benchmark(BENCHMARK).samples

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The conditions that it declares and the windows can be shown under, the richest first."""
        shown = [each for each in RICHEST_FIRST if each is not Condition.POSE_GAZE or self.cases.table.info.has_gaze]
        return tuple(condition for condition in shown if condition in self.declared.conditions)

    @property
    def n_cases(self) -> int:
        """Number of windows."""
        return len(self.cases.table.chosen(split="test"))

    @property
    def limits(self) -> str:
        """Say whether its samples are one design."""
        return "its samples are one design" if self.declared.one_design else "fewer samples are a prefix of more"

    def learns(self, loaded: LoadedMethod) -> bool:
        """Return True if a run would fit it to the training windows."""
        if isinstance(loaded.adapter, RemoteMethod):
            return loaded.adapter.trainable
        return hasattr(loaded.adapter, "fit")

    def fitted_spec(self) -> MethodSpec:
        """Fit it as a run does: it is shown the training windows of the table."""
        return self._fitted_to(self.cases.table)

    def _fitted_to(self, table: WindowsTable) -> MethodSpec:
        return load_benchmark(BENCHMARK).fitted(self._as_given, table, Condition.POSE)

    def observed(self, condition: Condition, table: WindowsTable | None = None) -> ObservedBatch:
        """Return all windows as a run shows them.

        Args:
            condition: What is known of them.
            table: Where they are; by default the one with their futures.
        """
        if table is None:
            if condition not in self._observed:
                self._observed[condition] = self.observed(condition, self.cases.table)
            return self._observed[condition]
        places = table.chosen(split="test")
        frame = load_prediction_protocol().evaluation.frame
        return next(table.batches(condition, places, frame=frame, size=len(places)))[0]

    def batch(self, rows: Sequence[int], condition: Condition, *, sample: int = 0) -> ObservedBatch:
        """See :meth:`MethodSubject.batch`; another sample has other keys."""
        batch = self.rows_of(self.observed(condition), rows)
        return self.with_keys(batch, sample * _OTHER_KEYS) if sample else batch

    @staticmethod
    def with_keys(batch: ObservedBatch, added: int) -> ObservedBatch:
        """Return the batch with other keys."""
        return dataclasses.replace(batch, key=tuple((key + added) % 2**63 for key in batch.key))

    def rows_of(self, batch: ObservedBatch, rows: Sequence[int]) -> ObservedBatch:
        """See :meth:`MethodSubject.rows_of`."""
        return batch.chosen(rows)

    def nudged(self, batch: ObservedBatch, by: np.float32) -> ObservedBatch:
        """Move the observed poses."""
        return dataclasses.replace(batch, observed_joints=batch.observed_joints + by)

    def ask(
        self, batch: ObservedBatch, *, seed: int = 0, state_seed: int = STATE_SEED, n_samples: int | None = None
    ) -> Answer:
        """See :meth:`MethodSubject.ask`.

        Args:
            batch: What it is asked.
            seed: Of the run.
            state_seed: Of the global generators.
            n_samples: Futures of each window; :attr:`samples` by default.
        """
        return self._asked(self.adapter, batch, seed=seed, state_seed=state_seed, n_samples=n_samples or self.samples)

    def ask_without_futures(self, condition: Condition, rows: Sequence[int]) -> Answer:
        """Make the predictor anew where no future is to be found, fit it there if it learns, and ask it.

        Args:
            condition: What it knows.
            rows: Numbers of the windows.
        """
        samples = self.samples
        learns = self.learns(self.loaded) and self.spec.weights is None
        # Whatever the predictor has kept from before is gone with it.
        unload_method()
        spec = self._fitted_to(self.cases.blind) if learns else self._as_given
        batch = self.rows_of(self.observed(condition, self.cases.blind), rows)
        answer = self._asked(spec.load().adapter, batch, seed=0, state_seed=STATE_SEED, n_samples=samples)
        unload_method()
        vars(self).pop("loaded", None)
        return answer

    def _asked(self, predictor: Any, batch: ObservedBatch, *, seed: int, state_seed: int, n_samples: int) -> Any:
        of_one = "1 window" if len(batch) == 1 else f"{len(batch)} windows"
        self.asking(f"while it predicted {n_samples} futures of {of_one} under {batch.condition.value}")
        answer = ask_predictor(
            predictor, batch, n_samples=n_samples, seed=seed, state_seed=state_seed, threads=self.spec.threads
        )
        self.drew_from.update(answer.drew_from)
        return answer


def anchored(batch: ObservedBatch) -> ObservedBatch:
    """Return a batch at the rate of anchored windows, 20 frames a second, made of the last observed frames."""
    rules = load_prediction_protocol().windows.at(20.0)
    last = slice(-rules.observed_frames, None)
    return replace(
        batch,
        fps=rules.fps,
        n_future=rules.future_frames,
        observed_joints=batch.observed_joints[:, last],
        gaze=None if batch.gaze is None else batch.gaze[:, last],
        gaze_valid=None if batch.gaze_valid is None else batch.gaze_valid[:, last],
    )


_PREDICT = Remedy(
    "Run predict() on this batch and repair what it raises; a predictor may only refuse options and weights.",
    "Repair what keeps the program from answering 'predict' with 'futures': its log (stderr) is shown with the error.",
)
_SHAPES = Remedy(
    "Return prbench_benchmarks.motion_prediction.batch.Futures(joints=joints): joints is an array"
    " (windows, samples, frames, joints, 3) with"
    " n_samples futures of batch.n_future frames each, without the observed ones.",
    "Send one row a window: its opaque_id, and joints with n_samples times n_future times the numbers of a pose,"
    " sample by sample and frame by frame, without the observed frames (docs/wire-protocol.md).",
)
_DTYPE = Remedy("Return decimals: joints.astype(np.float32), in metres.", "Send joints as list<float>, in metres.")
_FINITE = "Look for a division by zero (a body that stands still has no speed) and for weights that hold NaN."
_PAST = "Leave the observed frames away: the first frame of a future is the one after the last observed frame."
_REFUSED_PAYLOAD = "cannot be used"
_SAME = 1e-4  # metres


@check("predicts", "it predicts under every condition that it declares", needs=("load",))
def predicts(subject: PredictorSubject) -> Iterator[Finding]:
    """Predict under each declared condition; none may raise."""
    if not subject.conditions:
        yield skipped("these windows have no gaze, without which it does not predict.")
        return
    yield from form.by_condition(
        {condition: subject.standard(condition) for condition in subject.conditions},
        lambda answer: not answer.answered and not _program_misshaped(answer),
        _PREDICT,
        said=f"{subject.samples} futures of each window",
        things="futures",
    )
    if restarts := getattr(subject.adapter, "restarts", 0):
        yield failed(
            f"the program ended by itself and was started again ({restarts} times); its log says why.",
            "Repair what ends it: a run starts a program again only once for each batch.",
        )


@check("shapes", "futures have the asked shape", needs=("load",))
def shapes(subject: PredictorSubject) -> Iterator[Finding]:
    """Compare shapes with (windows, samples, frames, joints, 3)."""
    yield from form.by_condition(
        _answered(subject), _is_misshapen, _SHAPES, said="(windows, samples, frames, joints, 3)", things="futures"
    )


@check("dtype", "positions are decimals of enough digits", needs=("load", "shapes"))
def dtype(subject: PredictorSubject) -> Iterator[Finding]:
    """Require floating point, and warn of half precision."""
    answers = _answered(subject)
    yield from form.by_condition(
        answers, lambda answer: not _is_floating(answer), _DTYPE, said="floating point", things="futures"
    )
    coarse = [name.value for name, each in answers.items() if _kind(each) == np.dtype(np.float16)]
    if coarse:
        yield warning(f"{', '.join(coarse)}: joints come as float16, whose steps are 1 mm at 2 m.", _DTYPE)


@check("finite", "no position is NaN or infinite", needs=("load", "shapes", "dtype"))
def finite(subject: PredictorSubject) -> Iterator[Finding]:
    """Require a finite number everywhere."""
    yield from form.by_condition(
        _answered(subject), _has_nan, _FINITE, said="all positions are numbers", things="futures"
    )


@check("past", "futures are no copy of the past", needs=("load", "shapes", "dtype", "finite"))
def past(subject: PredictorSubject) -> Iterator[Finding]:
    """Look for futures that begin with the observed frames, or hold them in one piece."""
    answers = _answered(subject)
    copied = {condition: _copies(answer) for condition, answer in answers.items()}
    for condition, number in copied.items():
        if number:
            asked = len(answers[condition].batch)
            yield failed(
                f"under {condition.value}: the futures of {number} of {asked} windows begin with the observed frames.",
                _PAST,
            )
    if not answers:
        yield skipped("there are no futures to look at.")
    elif not any(copied.values()):
        yield passed(f"none begins with the observed frames, under {', '.join(each.value for each in answers)}.")


def _answered(subject: PredictorSubject) -> dict[Condition, Answer]:
    answers = {condition: subject.standard(condition) for condition in subject.conditions}
    return {name: each for name, each in answers.items() if each.answered or _program_misshaped(each)}


def _program_misshaped(answer: Answer) -> bool:
    """Return True where a program's payload was refused before it became futures."""
    return not answer.answered and _REFUSED_PAYLOAD in answer.error and "finite" not in answer.error


def _is_misshapen(answer: Answer) -> bool:
    if answer.motions is not None:
        return False
    if _program_misshaped(answer) or not isinstance(answer.returned, Futures):
        return True
    batch = answer.batch
    expected = (len(batch), answer.n_samples, batch.n_future, len(batch.joint_names), 3)
    return np.shape(answer.returned.joints) != expected


def _kind(answer: Answer) -> np.dtype | None:
    joints = answer.given_joints
    return None if joints is None else joints.dtype


def _is_floating(answer: Answer) -> bool:
    found = _kind(answer)
    return found is None or np.issubdtype(found, np.floating)


def _has_nan(answer: Answer) -> bool:
    joints = answer.given_joints
    return answer.motions is None and joints is not None and not bool(np.isfinite(joints).all())


def _copies(answer: Answer) -> int:
    """Count the windows of moving people all of whose futures begin with the observed frames."""
    joints = answer.given_joints
    if joints is None:
        return 0
    observed = answer.batch.observed_joints
    shared = min(observed.shape[1], joints.shape[2])
    moving = np.ptp(observed, axis=1).max(axis=(1, 2)) > 10 * _SAME
    apart = np.abs(joints[:, :, :shared] - observed[:, None, :shared]).max(axis=(1, 2, 3, 4))
    return int((moving & (apart < _SAME)).sum())


_FURTHER_KEYS = 104_729
_NO_FUTURE = (
    "A predictor learns from what it is given alone: the training windows in fit(), the observed frames in predict()."
    " Open no table of windows, and take nothing from the objects around the batch."
)
_PREFIX = (
    "Draw sample k from a generator of its own, so that it does not know how many are asked for. Where the K samples of"
    " a window are one design, say so: one_design = True; then fewer samples have no scores."
)


@check("firewall", "without futures in the table every prediction stays the same", of_motions=True)
def firewall(subject: PredictorSubject) -> Iterator[Finding]:
    """Make it anew where all frames after the observed ones are NaN, and compare every byte."""
    for condition in subject.working:
        usual = subject.standard(condition)
        blind = subject.ask_without_futures(condition, subject.rows)
        if blind.motions is None:
            yield failed(f"under {condition.value}, with NaN in all future frames: {blind.error}", _NO_FUTURE)
            return
        if same_bytes(usual, blind):
            continue
        again = subject.ask(usual.batch)
        moved = float(largest_changes(usual, blind).max())
        if again.motions is not None and not same_bytes(usual, again) and moved <= TOLERANCE:
            yield warning(
                f"under {condition.value}: joints moved by up to {moved:.1e} m, as they do when it is asked twice.",
                "That is rounding, which differs from call to call.",
                change_m=moved,
            )
            return
        yield failed(
            f"under {condition.value}, with NaN in all future frames, joints moved by up to {metres(moved)}.",
            _NO_FUTURE,
            change_m=moved,
        )
        return
    yield passed(
        f"with NaN in all future frames the same bytes, under {', '.join(each.value for each in subject.working)}."
    )


@check("seed", "seed, key and number of the sample decide what is drawn", needs=("determinism",), of_motions=True)
def seed(subject: PredictorSubject) -> Iterator[Finding]:
    """Ask with another seed, and with other keys."""
    first = subject.standard(subject.main)
    reseeded = subject.ask(first.batch, seed=1)
    renamed = subject.ask(subject.with_keys(first.batch, _FURTHER_KEYS))
    for name, answer in (("another seed", reseeded), ("other keys", renamed)):
        if answer.motions is None:
            yield failed(f"with {name}: {answer.error}", subject.own_generators)
            return
    by_seed = largest_changes(first, reseeded) > 0
    by_key = largest_changes(first, renamed) > 0
    if not by_seed.any() and not by_key.any():
        yield passed("neither seed nor keys change anything: it draws nothing.")
        return
    for name, changed in (("another seed", by_seed), ("other keys", by_key)):
        if not changed.all():
            still = int((~changed).sum())
            yield failed(f"with {name}, {still} of {len(changed)} windows stayed the same.", subject.own_generators)
            return
    if _all_samples_equal(first):
        yield warning(
            f"the {first.n_samples} futures of each window are the same, although the seed changes them.",
            subject.own_generators,
        )
        return
    moved = float(largest_changes(first, reseeded).max())
    yield passed(f"another seed or key moves joints, by up to {metres(moved)}.", change_m=moved)


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
        apart = np.linalg.norm(_joints(first)[:, :shared] - _joints(other)[:, :shared], axis=-1).max()
        worst = max(worst, float(apart))
    asked = f"1, {first.n_samples} and {subject.many_samples} futures of each window"
    if worst == 0.0:
        yield passed(f"{asked} begin with the same bytes.", change_m=worst)
    elif worst <= TOLERANCE:
        yield warning(f"{asked} begin alike but for {worst:.1e} m.", "That is rounding.", change_m=worst)
    else:
        yield failed(f"{asked}: those that all share moved by up to {metres(worst)}.", _PREFIX, change_m=worst)


@check("rates", "windows of another rate and length", of_motions=True)
def rates(subject: PredictorSubject) -> Iterator[Finding]:
    """Ask about windows of 20 frames a second, as tables of prime-and-reach give them."""
    if subject.learns(subject.loaded):
        yield skipped("it learns from the windows of a run, which are of one rate.")
        return
    batch = anchored(subject.standard(subject.main).batch)
    answer = subject.ask(batch)
    shape = f"{batch.shape[1]} observed and {batch.n_future} future frames at {batch.fps:g} a second"
    if answer.motions is None:
        yield warning(
            f"{shape}: {answer.error}",
            "Windows around the events of a prime-and-reach table have 20 frames a second. Take lengths and rate from"
            " the batch, or interpolate to your own.",
        )
        return
    yield passed(f"{shape} work, too.")


def _joints(answer: Answer) -> np.ndarray:
    assert answer.motions is not None
    return answer.motions.joints


def _all_samples_equal(answer: Answer) -> bool:
    joints = _joints(answer)
    return answer.n_samples > 1 and bool((joints == joints[:, :1]).all())


_JUMP_WARNING = 0.1
_JUMP_FAILURE = 1.0
"""Metres between the last observed and the first predicted frame, median over windows."""
_BONES_WARNING = 10.0
_BONES_FAILURE = 50.0
"""Per cent, median over windows."""


@check("first-frame", "futures go on where the observed frames end", of_motions=True)
def first_frame(subject: PredictorSubject) -> Iterator[Finding]:
    """Measure the jump from the last observed to the first predicted frame."""
    answer = subject.standard(subject.main)
    jump = float(np.median(first_frame_jump(answer.motions.joints, answer.batch.observed_joints[:, -1])))
    text = f"{metres(jump)} from the last observed to the first predicted frame (median)."
    if jump > _JUMP_FAILURE:
        yield failed(text, "Answer in metres, Y up, in the frame of the observed joints.", jump_m=jump)
    elif jump > _JUMP_WARNING:
        yield warning(
            text, "A body cannot move so far in a frame; the metrics show it as first-frame jump.", jump_m=jump
        )
    else:
        yield passed(text, jump_m=jump)


@check("bone-lengths", "one body, of one size", of_motions=True)
def bones(subject: PredictorSubject) -> Iterator[Finding]:
    """Compare bone lengths with those of the last observed pose."""
    answer = subject.standard(subject.main)
    joints = subject.cases.table.joints
    errors = bone_error(answer.motions.joints, answer.batch.observed_joints[:, -1], joints.bones)
    error = float(np.median(errors))
    text = f"bones differ from those of the last observed pose by {error:.1f} % (median)."
    remedy = "Look at the order of joints (batch.joint_names), at units, and at averages over turned poses."
    if error > _BONES_FAILURE:
        yield failed(text, remedy, bone_error_percent=error)
    elif error > _BONES_WARNING:
        yield warning(text, remedy, bone_error_percent=error)
    else:
        yield passed(text, bone_error_percent=error)


CHECKS = (
    *form.LOADING,
    predicts,
    shapes,
    dtype,
    finite,
    past,
    reproducibility.determinism,
    reproducibility.global_random,
    firewall,
    seed,
    samples,
    rates,
    reproducibility.single_row,
    reproducibility.batch,
    first_frame,
    bones,
    *body.RESOURCES,
    reproducibility.process,  # in a process of its own, so last
)
"""In the order in which they are made; those that ask for no motions are the checks of any method."""


def _futures(spec: MethodSpec, request: CheckRequest, folder: Path) -> PredictorSubject:
    cases = synthetic_windows(folder) if request.data is None else windows_of_table(request.data, folder)
    return PredictorSubject(spec, cases, folder)


def judge() -> Judge:
    """Return the checks of predictors, for :func:`prbench.checking.conformance.session.judge_of`."""
    return Judge(CHECKS, _futures, require_windows)
