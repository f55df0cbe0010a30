"""Checks that a body moves from where it stood to the goal, and of the memory and time that this takes."""

from __future__ import annotations

import gc
from collections.abc import Iterable, Iterator

import numpy as np
import psutil

from prbench.checking.conformance.findings import Finding, check, failed, passed, skipped, warning
from prbench.checking.conformance.subject import Answer, MethodSubject, Subject
from prbench.checking.doctor import Diagnosis, Expected, diagnose
from prbench.contract import Condition
from prbench.geometry.skeleton import WRISTS, Joint, bone_lengths, facing_yaw
from prbench.harness.methods.loading import unload_method
from prbench.harness.methods.motions import coordinate_problem
from prbench.harness.methods.process import EXIT_SECONDS, exit_story
from prbench.harness.methods.remote import RemoteMethod

_AWAY_WARNING = 0.25
_AWAY_FAILURE = 1.5
"""Metres between the first pelvis and the canonical origin, on the ground (median over sequences)."""
_TURNED_WARNING = 30.0
_TURNED_FAILURE = 90.0
"""Degrees between the first heading and +Z (median)."""
_FLOOR_WARNING = 0.10
_FLOOR_FAILURE = 0.50
"""Metres between the lowest joint of a motion and Y = 0 (median)."""
_INITIAL_WARNING = 0.10
"""Metres between the first frame and the initial pose, mean over joints (median over sequences)."""
_BONES_WARNING = 0.10
_BONES_FAILURE = 0.50
"""Relative change of bone lengths (median over bones and sequences)."""
_NO_BODY = frozenset({"shape", "features", "not-finite", "empty-frames", "standardised", "unit", "joint-order"})
_ELSEWHERE = _NO_BODY | {"up-axis", "left-right", "mirrored", "root", "facing", "position"}
"""Kinds of diagnosis that would only be told once more, of bones and of places."""
_PLACES = frozenset({"facing", "position"})
_CANONICAL = (
    "Give positions in the canonical frame of the sequence's first frame: metres, Y up, the pelvis of frame 0 over the"
    " origin and facing +Z (the left side on +X), the lowest joint of the motion on Y = 0."
)


@check("doctor", "no sign of a wrong frame rate, axis, unit, joint order …", of_motions=True)
def doctor(subject: Subject) -> Iterator[Finding]:
    """Run ``prbench doctor`` on the motions, with the conditions as expectations."""
    found = 0
    for condition in subject.working:
        diagnoses = _diagnosed(subject, condition)
        for diagnosis in diagnoses:
            # An average pose stands where the average person stood; 'canonical-frame' measures how far that is off.
            if subject.declared.motionless and diagnosis.kind in _PLACES:
                continue
            evidence = diagnosis.evidence.rstrip(".")
            cause = diagnosis.cause.rstrip(".")
            text = f"{diagnosis.kind}, under {condition.value}: {evidence}. Likely cause: {cause}."
            yield (failed if _is_failure(subject, diagnosis) else warning)(text, diagnosis.remedy)
            found += 1
        too_far = _too_far(subject.standard(condition))
        if too_far and not any(_is_failure(subject, diagnosis) for diagnosis in diagnoses):
            yield failed(f"under {condition.value}: {too_far}", _CANONICAL)
            found += 1
    if not found:
        yield passed("nothing that prbench doctor looks for.")


def _too_far(answer: Answer) -> str:
    """Return what would end a run although every coordinate is a number, or an empty text."""
    for row in range(len(answer.batch)):
        if problem := coordinate_problem(answer.motion(row)):
            return f"sequence #{row}, {problem}"
    return ""


def _diagnosed(subject: Subject, condition: Condition) -> tuple[Diagnosis, ...]:
    answer = subject.standard(condition)
    motions = [answer.motion(row) for row in range(len(answer.batch))]
    return diagnose(motions, _expected(answer), fps=answer.batch.fps)


def _is_failure(subject: Subject, diagnosis: Diagnosis) -> bool:
    return diagnosis.certain and not subject.declared.motionless  # a mean pose is nobody's pose


@check("canonical-frame", "motions begin at the origin, face +Z and stand on the floor", of_motions=True)
def canonical_frame(subject: Subject) -> Iterator[Finding]:
    """Measure place and heading of the first frames, and the height of the lowest joints."""
    if hidden := _hidden_by(subject, _ELSEWHERE | {"floor"}, subject.working):
        yield hidden
        return
    for condition in subject.working:
        answer = subject.standard(condition)
        motions = [answer.motion(row) for row in range(len(answer.batch))]
        away = float(np.median([np.hypot(*motion[0, Joint.PELVIS, [0, 2]]) for motion in motions]))
        turned = float(np.median([_turned(motion[0]) for motion in motions]))
        floor = float(np.median([motion[..., 1].min() for motion in motions]))
        text = (
            f"under {condition.value}: in the first frame the pelvis is {away * 100:.0f} cm from the origin and the"
            f" body {turned:.0f}° from +Z; the lowest joint is at {floor * 100:+.0f} cm (medians)."
        )
        numbers = {"away_m": away, "turned_deg": turned, "floor_m": floor}
        # A baseline of one average pose is a method, too, and allowed to stand where it was averaged.
        still = subject.declared.motionless  # an average pose stands where the average person stood
        if not still and (away > _AWAY_FAILURE or turned > _TURNED_FAILURE or abs(floor) > _FLOOR_FAILURE):
            yield failed(text, _CANONICAL, **numbers)
        elif away > _AWAY_WARNING or turned > _TURNED_WARNING or abs(floor) > _FLOOR_WARNING:
            yield warning(text, _CANONICAL, **numbers)
        else:
            yield passed(text, **numbers)


def _hidden_by(subject: Subject, kinds: frozenset[str], conditions: Iterable[Condition]) -> Finding | None:
    """Return a skip if a diagnosed fault already explains a measurement, else None."""
    for condition in conditions:
        for diagnosis in _diagnosed(subject, condition):
            if diagnosis.kind in kinds and _is_failure(subject, diagnosis):
                return skipped(f"not looked at before 'doctor' passes ({diagnosis.kind}).")
    return None


@check("initial-pose", "motions begin with the pose that they were given", of_motions=True)
def initial_pose(subject: Subject) -> Iterator[Finding]:
    """Measure the distance between the first frame and ``initial_joints``."""
    given = [condition for condition in subject.working if subject.standard(condition).batch.initial_joints is not None]
    if hidden := _hidden_by(subject, _ELSEWHERE, given):
        yield hidden
        return
    for condition in given:
        answer = subject.standard(condition)
        assert answer.batch.initial_joints is not None
        errors = [
            float(np.linalg.norm(answer.motion(row)[0] - pose, axis=-1).mean())
            for row, pose in enumerate(answer.batch.initial_joints)
        ]
        text = (
            f"under {condition.value}: the first frame is {100 * np.median(errors):.1f} cm from the initial pose"
            f" (median; largest {100 * max(errors):.1f} cm; mean over joints)."
        )
        numbers = {"error_m": float(np.median(errors)), "largest_error_m": max(errors)}
        if np.median(errors) > _INITIAL_WARNING:
            yield warning(text, "Frame 0 is the initial pose, not the frame after it.", **numbers)
        else:
            yield passed(text, **numbers)
    if not given:
        yield skipped("it is given no initial pose.")


@check("bone-lengths", "one body, of one size, all the time", of_motions=True)
def bones(subject: Subject) -> Iterator[Finding]:
    """Measure how bone lengths change within a motion, and differ from the initial pose."""
    if hidden := _hidden_by(subject, _NO_BODY, subject.working):
        yield hidden
        return
    for condition in subject.working:
        answer = subject.standard(condition)
        lengths = [bone_lengths(answer.motion(row).astype(np.float64)) for row in range(len(answer.batch))]
        shortest = float(np.median([np.median(own) for own in lengths]))
        change = float(np.median([_spread(own) for own in lengths]))
        numbers = {"change": change, "typical_bone_m": shortest}
        text = f"under {condition.value}: bones change by {100 * change:.1f} % within a motion"
        if answer.batch.initial_joints is not None:
            own = bone_lengths(answer.batch.initial_joints.astype(np.float64))
            other = float(np.median([np.abs(np.median(one, axis=0) / own[row] - 1) for row, one in enumerate(lengths)]))
            numbers["against_initial_pose"] = other
            text += f" and differ by {100 * other:.1f} % from those of the initial pose"
        text += " (medians over bones and sequences)."
        worst = max(change, numbers.get("against_initial_pose", 0.0))
        if shortest < 0.01:
            yield failed(
                f"under {condition.value}: the bones are {1000 * shortest:.1f} mm long.",
                "These are not 22 joints of a body in metres: are positions filled in at all, and not only rotations?",
                **numbers,
            )
        elif worst > _BONES_FAILURE:
            yield failed(text, "Check that all 22 joints are positions of one body in Joint order.", **numbers)
        elif worst > _BONES_WARNING:
            yield warning(
                text,
                "Predict rotations, or put the bones back to their length (bone by bone from the pelvis).",
                **numbers,
            )
        else:
            yield passed(text, **numbers)


@check("goal", "how near it comes to the goal", of_motions=True)
def goal(subject: Subject) -> Iterator[Finding]:
    """Report the distance to the goal at the end; a run judges it, not this check."""
    given = [name for name in subject.working if name in (Condition.GOAL_LOCATION, Condition.GOAL_POSE)]
    if hidden := _hidden_by(subject, _ELSEWHERE | {"heading"}, given):
        yield hidden
        return
    for condition in given:
        answer = subject.standard(condition)
        distances = np.array([_to_goal(answer, row) for row in range(len(answer.batch))])
        what = "the nearer wrist" if condition is Condition.GOAL_LOCATION else "the body (mean over joints)"
        yield passed(
            f"under {condition.value}: {what} ends {100 * np.median(distances[:, 1]):.0f} cm from the goal, from"
            f" {100 * np.median(distances[:, 0]):.0f} cm at the start (medians).",
            first_m=float(np.median(distances[:, 0])),
            last_m=float(np.median(distances[:, 1])),
        )
    if not given:
        yield skipped("it is given no goal.")


def _expected(answer: Answer) -> list[Expected]:
    batch = answer.batch
    return [
        Expected(
            initial_joints=None if batch.initial_joints is None else batch.initial_joints[row],
            previous_joints=None if batch.previous_joints is None else batch.previous_joints[row],
            goal_joints=None if batch.goal_joints is None else batch.goal_joints[row],
            goal_location=None if batch.goal_location is None else batch.goal_location[row],
            n_frames=int(batch.n_frames[row]),
            fps=batch.fps,
        )
        for row in range(len(batch))
    ]


def _turned(pose: np.ndarray) -> float:
    try:
        return abs(float(np.degrees(facing_yaw(pose.astype(np.float64)))))
    except ValueError:  # no heading: a body that lies, or no body
        return 180.0


def _spread(lengths: np.ndarray) -> float:
    """Median over bones of the range of a bone's lengths within a motion, relative to its mean."""
    mean = np.maximum(lengths.mean(axis=0), 1e-9)
    return float(np.median((lengths.max(axis=0) - lengths.min(axis=0)) / mean))


def _to_goal(answer: Answer, row: int) -> tuple[float, float]:
    """Distance to the goal in the first and the last frame, metres."""
    ends = answer.motion(row)[[0, -1]]
    batch = answer.batch
    if batch.goal_location is not None:
        distances = np.linalg.norm(ends[:, WRISTS] - batch.goal_location[row], axis=-1).min(axis=1)
    else:
        assert batch.goal_joints is not None
        distances = np.linalg.norm(ends - batch.goal_joints[row], axis=-1).mean(axis=1)
    return float(distances[0]), float(distances[1])


CHECKS = (doctor, canonical_frame, initial_pose, bones, goal)


_ROUNDS = 14
_FEWEST_ROUNDS = 8
_SETTLING = 3
_PATIENCE = 20.0  # seconds for all rounds
_GROWTH_WARNING = 32 * 1024
_GROWTH_FAILURE = 128 * 1024
"""Bytes a motion that stay behind; 128 KiB are 2.2 GiB in a run over 18,000 sequences."""
_LEAST_GROWTH = 4 * 1024 * 1024  # bytes in all that count as growth


@check("memory", "memory does not grow from batch to batch", needs=("determinism",), of_motions=True)
def memory(subject: MethodSubject) -> Iterator[Finding]:
    """Measure resident memory of this process and its children after each of many equal batches."""
    usual = subject.standard(subject.main)
    rounds = min(_ROUNDS, int(_PATIENCE / max(usual.seconds, 1e-6)))
    if rounds < _FEWEST_ROUNDS:
        yield skipped(
            f"a batch of {len(usual.batch)} takes {usual.seconds:.1f} s; {_FEWEST_ROUNDS} of them would take more than"
            f" {_PATIENCE:g} s."
        )
        return
    growth = np.inf
    resident: list[float] = []
    # What allocators, kernels and other threads of this process take is taken once, however late; a leak goes on. So
    # growth is looked at once more, and the smaller one counts.
    for _ in range(2):
        first = len(resident)
        gc.freeze()  # what is there already is not looked through again and again
        try:
            for _ in range(rounds):
                if error := subject.ask(usual.batch).error:
                    yield failed(f"in repeated batches: {error}", "Give back what a batch has taken.")
                    return
                resident.append(_resident_bytes())
        finally:
            gc.unfreeze()
        settled = np.array(resident[first + _SETTLING :], dtype=np.float64)
        growth = min(growth, growth_per_round(settled) / len(usual.batch))
        if growth < _GROWTH_WARNING:
            break
    total = max(resident) / 2**20
    kept = f"{growth / 1024:.0f} KiB a {subject.answer} stayed behind over {len(resident)} batches"
    text = f"{kept}; {total:.0f} MiB in all."
    remedy = "Keep nothing of a batch: look for lists and caches that grow, and for torch graphs (torch.no_grad())."
    numbers = {"growth_bytes_a_motion": growth, "resident_mib": total}
    if growth >= _GROWTH_FAILURE:
        yield failed(text, remedy, **numbers)
    elif growth >= _GROWTH_WARNING:
        yield warning(text, remedy, **numbers)
    else:
        yield passed(f"no growth over {len(resident)} batches; {total:.0f} MiB in all.", **numbers)


@check("speed", "how long it takes", of_motions=True)
def speed(subject: MethodSubject) -> Iterator[Finding]:
    """Measure the seconds of the first batch, which pays for what loads on first use, and of a usual one."""
    first = subject.first_answer
    usual = subject.standard(subject.main)
    a_motion = usual.seconds / len(usual.batch)
    yield passed(
        f"first batch ({len(first.batch)}) {first.seconds:.2f} s; then {len(usual.batch)} in {usual.seconds:.2f} s:"
        f" {a_motion:.3g} s a {subject.answer}, {1 / max(a_motion, 1e-9):.3g} {subject.answer}s a second on"
        f" {subject.spec.device}.",
        first_batch_s=first.seconds,
        motion_s=a_motion,
        motions_a_second=1 / max(a_motion, 1e-9),
    )


@check("exit", "its program ends by itself, with status 0", needs=("generates", "predicts"), of_motions=True)
def exits(subject: MethodSubject) -> Iterator[Finding]:
    """Close its stdin after a batch, as a run does at its end."""
    if subject.is_installed or not isinstance(subject.adapter, RemoteMethod):
        yield skipped("it has no program of its own.")
        return
    program = subject.adapter
    subject.ask(subject.batch(subject.rows[:1], subject.main))
    unload_method()
    status = program.exit_status
    subject.load_again()
    if status == 0:
        yield passed("it ended with exit status 0 when its stdin was closed.")
        return
    did = f"was still running after {EXIT_SECONDS:g} s and had to be ended" if status is None else exit_story(status)
    yield warning(
        f"when its stdin was closed, the program {did}.",
        "At the end of its input a program exits with status 0; motions are not touched by it, but schedulers and"
        " fences take it for a failure (docs/wire-protocol.md).",
    )


def _resident_bytes() -> int:
    """Return the memory of this process and its living children."""
    gc.collect()
    own = psutil.Process()
    total = own.memory_info().rss
    for child in own.children(recursive=True):
        try:
            total += child.memory_info().rss
        except psutil.Error:
            continue
    return total


def growth_per_round(resident: np.ndarray) -> float:
    """Return the bytes that a round adds: the median of all slopes (Theil and Sen), 0 unless most rounds add.

    Args:
        resident: Bytes after each round, settled.
    """
    # The median of slopes ignores single jumps, such as a cache that is filled once.
    first, second = np.triu_indices(len(resident), k=1)
    slope = float(np.median((resident[second] - resident[first]) / (second - first)))
    rising = np.mean(np.diff(resident) > 0)
    if resident[-1] - resident[0] < _LEAST_GROWTH or rising < 0.5:
        return 0.0
    return max(slope, 0.0)


RESOURCES = (memory, speed, exits)
