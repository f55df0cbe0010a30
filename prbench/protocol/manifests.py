"""Dataset manifests and the benchmark protocol as frozen data classes, read once from TOML."""

from __future__ import annotations

import csv
import hashlib
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec

from prbench import datasets
from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.files import bounded
from prbench.files.bounded import foreign_input, require
from prbench.shown import quoted

Redistribution = Literal["none", "non-commercial", "yes"]
# Name of the rules that come with prbench; a user's own have another one (:mod:`prbench.protocol.own_protocol`).
PROTOCOL_NAME = "prime-and-reach"


class BodySource(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The source of a dataset's body poses and their mapping to the 22 joints.

    Attributes:
        joint_mapping: Native joint of each of the 22 joints; ``a+b`` is the mean of two, ``0.6 a + 0.4 b`` a point
            between them. Empty where the joints are native already.
        other_mappings: Further mappings by the name under which a reader's option chooses them.
        citation: BibTeX of the method that estimated the poses, where they are not the dataset's own.
    """

    pose_source: str
    head_tilt_deg: float
    joint_mapping: tuple[str, ...] = ()
    other_mappings: dict[str, tuple[str, ...]] = {}
    citation: str = ""


class InHandRule(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The rule of an object that counts as held: a contact point is close, and it moves. Metres and seconds."""

    contact: Literal["middle_finger_base", "wrist", "hand_vertex"]
    target: Literal["oriented_box", "origin", "surface"]
    distance: float
    moving_speed: float
    moving_window: float
    minimum_duration: float
    join_gap: float
    rest_tolerance: float
    smallest_displacement: float
    drop_hinged: bool = True


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One dataset: origin, licence, layout, and every number that its curation uses.

    Attributes:
        required_roles: Role under which the reader finds each required file (``a|b``: one of the two, ``a*``: any), and
            how a user knows it.
        wanted_roles: The same for files without which a recording is read, and yields less.
        estimate: The figures that ``--dry-run`` reckons with, measured with one core on synthetic recordings: input
            files read and curated, and bytes of table (and as many of the parts that it is made from) a byte of input.
            Empty for corpora.
        kind: A table of prime-and-reach sequences, or a text-motion corpus for pre-training.
        other_bodies: Further sources of bodies by the name under which ``--poses`` chooses them (``egoallo``).
        in_hand: The in-hand rule; None where the dataset annotates its events.
        publishes_priming: True if the dataset's own files say when events were primed (``--priming published``).
        published_counts: How many annotations there are, by who counted them; for comparison alone.
        thresholds: Numbers of the reader that the dataset's page leaves to choose, by name.
        known_bad: Name (or beginning of the name) of a recording that must be skipped, and why.
        excluded: Recording that is left out unless the reader's option ``include_excluded`` is on, and why.
        object_extents: Boxes of kinds of objects whose meshes may be missing: lower and upper end along x, y, z,
            metres.
        splits: Split of each recording of a stored list: of an own dataset ``splits/<dataset>.csv``. Recordings in no
            list are drawn (docs/specification/curation.md#splits).
    """

    schema: Literal[1]
    name: str
    title: str
    homepage: str
    how_to_obtain: str
    licence: str
    redistribution: Redistribution
    citation: str
    required_files: tuple[str, ...]
    optional_files: tuple[str, ...]
    required_roles: dict[str, str] = {}
    wanted_roles: dict[str, str] = {}
    estimate: dict[Literal["megabytes_per_second", "table_share"], float] = {}
    rates_hz: dict[str, float]
    kind: Literal["benchmark", "corpus"] = "benchmark"
    body: BodySource
    other_bodies: dict[str, BodySource] = {}
    in_hand: InHandRule | None = None
    in_hand_alternatives: dict[str, InHandRule] = {}
    publishes_priming: bool = False
    published_counts: dict[str, dict[str, int]] = {}
    thresholds: dict[str, float] = {}
    known_bad: dict[str, str] = {}
    excluded: dict[str, str] = {}
    object_extents: dict[str, tuple[tuple[float, float], tuple[float, float], tuple[float, float]]] = {}
    splits: dict[str, Literal["train", "validation", "test"]] = {}

    def terms(self, *, synthetic: bool) -> dict[str, Any]:
        """Return title, licence, redistribution, homepage, citation and ``synthetic`` of a table of its recordings.

        Args:
            synthetic: True where the recordings were invented in the dataset's layout.
        """
        if synthetic:
            title = f"Invented recordings in the layout of {self.title}"
            licence = "MIT (invented by prbench, no recorded person)"
            nothing = {"homepage": "", "citation": ""}
            return {"title": title, "licence": licence, "redistribution": "yes", "synthetic": True, **nothing}
        kept = {name: getattr(self, name) for name in ("title", "licence", "redistribution", "homepage")}
        return {**kept, "citation": self.citation.strip(), "synthetic": False}

    def in_hand_rule(self, name: str | None) -> InHandRule | None:
        """Return the dataset's own rule (None where its events are annotated), or one of its alternatives by name.

        Raises:
            UsageError: for a name that the manifest does not list.
        """
        if name is None:
            return self.in_hand
        if name not in self.in_hand_alternatives:
            known = ", ".join(sorted(self.in_hand_alternatives)) or "none"
            raise UsageError(f"{self.name} has no in-hand rule '{name}'; its alternatives are: {known}.")
        return self.in_hand_alternatives[name]

    def body_source(self, poses: str | None) -> BodySource:
        """Return the dataset's own source of bodies, or the one that the reader's option ``poses`` names."""
        return self.body if poses is None else self.other_bodies.get(poses, self.body)

    def why_bad(self, recording_id: str) -> str | None:
        """Return the reason why a recording must be skipped, or None."""
        for name, reason in self.known_bad.items():
            # A sequence of several glasses is named once; the ids of its recordings go on with an underscore.
            if recording_id == name or recording_id.startswith(f"{name}_"):
                return reason
        return None


class CurationConstants(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Numbers of the path from event to sequence; metres and seconds.

    Attributes:
        minimum_prime: Seconds that a look must last to prime; 0 = a single gaze sample primes.
    """

    priming_window: float
    near_miss_distance: float
    lead: float
    minimum_movement: float
    ray_origin: Literal["eye", "camera"]
    largest_interpolated_gap: float
    minimum_prime: float


class SplitRule(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Shares of the two splits that are held out, of the length of all recordings that no list names.

    Attributes:
        tolerance: Share by which the test part may be longer, so that it holds more recordings.
        fewest_units: Recordings that the test part holds where as many fit.
    """

    test: float
    validation: float
    tolerance: float
    fewest_units: int


class Limit(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The number that a measure of a plausible motion reaches at least or exceeds at most.

    Attributes:
        flag: Remark on a motion that breaks the limit.
        source: Reason for the value, as the constants page gives it in full.
    """

    bound: Literal["least", "most"]
    value: float
    unit: str
    flag: str
    source: str


class MetricConstants(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Constants of the metrics: metres, seconds, and degrees where a name says so.

    ``threshold_tolerance`` is how close to a threshold a distance lies *on* it: the table stores positions as float32.
    ``foot_tolerance`` is the same for the heights and speeds of Foot Skating and slow slides.

    Attributes:
        plausible: The limits of plausible motions, by the name of :func:`prbench.metrics.plausible.body_numbers`.
        plausible_3: The limits of version 3 of the protocol.
    """

    prime_window: float
    prime_duration: float
    prime_distance: float
    deceleration_tolerance: float
    threshold_tolerance: float
    foot_tolerance: float
    head_smoothing: float
    reach_distance: float
    location_error_distance: float
    foot_height: float
    foot_speed: float
    foot_window: float
    prime_angle_deg: float
    arrival_margin: float
    slide_speed: float
    contact_height: float
    seat_height: float
    seat_travel: float
    drag_speed: float
    drag_way: float
    plausible: dict[str, Limit]
    plausible_3: dict[str, Limit]


class BreakdownConstants(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Bins of the goal's place, by which scores are broken down: the upper ends of all but the last, ascending.

    ``fewest_recordings`` and ``fewest_expected`` (sequences) are what an agreement's interval needs.
    """

    bearing: tuple[float, ...]
    distance: tuple[float, ...]
    height: tuple[float, ...]
    fewest_recordings: int
    fewest_expected: float


class BenchmarkProtocol(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One version of the benchmark's rules.

    Attributes:
        name: ``prime-and-reach``, which stands in no file and no digest, or the name of a user's own rules.
        text: The text condition of each action.
    """

    name: str = PROTOCOL_NAME
    version: int
    fps: float
    conditions: tuple[str, ...]
    curation: CurationConstants
    splits: SplitRule
    text: dict[Literal["pick", "put"], str]
    metrics: MetricConstants
    breakdown: BreakdownConstants

    @property
    def digest(self) -> str:
        """SHA-256 of the values; equal rules have equal digests, however the file is laid out."""
        return digest_of(self)

    @property
    def is_own(self) -> bool:
        """Return True for a user's own rules, False for those that come with prbench."""
        return self.name != PROTOCOL_NAME

    @property
    def label(self) -> str:
        """Name and version, as tables and messages show them."""
        return f"{self.name} {self.version}"


def digest_of(constants: msgspec.Struct) -> str:
    """SHA-256 of a manifest's, rule's or protocol's values."""
    values = msgspec.to_builtins(constants)
    if isinstance(constants, BenchmarkProtocol) and not constants.is_own:
        del values["name"]  # stands in no file of prbench's own rules
    if isinstance(constants, Manifest):
        del values["published_counts"]  # they decide nothing
    return hashlib.sha256(msgspec.json.encode(values, order="sorted")).hexdigest()


@cache
def load_manifest(dataset: str) -> Manifest:
    """Load the manifest of a dataset: prbench's own, or the one beside an installed package's reader.

    ``own-…`` has that of own recordings; :func:`read_own_manifest` reads a user's.

    Raises:
        UsageError: for a dataset without manifest, or whose package cannot be used.
        InputFileError: if the file is missing or does not fit the data class (naming the key).
    """
    dataset = datasets.layout_of(dataset)
    if dataset in datasets.own_datasets():
        own = read_toml("prbench_data_manifests", f"{dataset}.toml", Manifest)
        stored = resources.files("prbench_data_manifests") / "splits" / f"{dataset}.csv"
        if not stored.is_file():
            return own
        lines = [line for line in stored.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
        return msgspec.structs.replace(own, splits={row["recording_id"]: row["split"] for row in csv.DictReader(lines)})
    if dataset not in dataset_names():
        raise UsageError(f"unknown dataset '{dataset}'; known ones are: {', '.join(dataset_names())}.")
    file = datasets.folder_of(datasets.find_reader(dataset)) / f"{dataset}.toml"
    manifest = _convert_toml(file, Manifest)
    if manifest.name != dataset or manifest.kind != "benchmark":
        found = f"name = '{quoted(manifest.name)}' and kind = '{manifest.kind}'"
        raise InputFileError(file, "", expected=f"name = '{dataset}' and kind = 'benchmark'", found=found)
    return manifest


@foreign_input()
def read_own_manifest(path: Path) -> Manifest:
    """Read a user's manifest of own recordings (docs/own-recordings.md#build).

    Args:
        path: TOML with ``name``, ``licence``, ``redistribution`` and any other key of a manifest.

    Returns:
        The manifest; ``own-`` stands before its name, so that it never passes as another dataset's.

    Raises:
        InputFileError: if a key is missing, unknown or of another type, or the name is that of a known dataset.
    """
    values = bounded.read_toml(path, "a manifest's TOML file")
    shipped = msgspec.to_builtins(load_manifest(datasets.OWN))
    for key in ("name", "licence", "redistribution"):
        require(path, (key in values, key, "this key: it says who may use what", "no such key", ""))
    name = str(values["name"]).removeprefix(datasets.OWN_PREFIX)
    problem = datasets.dataset_name_problem(name, known=dataset_names())
    require(path, (not problem, "name", "a name of its own", f"'{name}': {problem}", ""))
    values["name"] = f"{datasets.OWN_PREFIX}{name}"
    for part in ("body", "thresholds", "in_hand"):  # what they do not state stays
        if isinstance(given := values.get(part, {}), dict):
            values[part] = {**shipped[part], **given}
    manifest = bounded.structured(path, {**shipped, **values}, Manifest)
    known = shipped["thresholds"]
    odd = next((key for key in manifest.thresholds if key not in known), "")
    remedy = did_you_mean(odd, known).strip()
    require(path, (not odd, "thresholds", f"keys among {', '.join(known)}", f"'{odd}'", remedy))
    return manifest


@cache
def load_protocol() -> BenchmarkProtocol:
    """Return the protocol of the prime-and-reach benchmark."""
    return read_toml("prbench_benchmarks.prime_and_reach", "protocol.toml", BenchmarkProtocol)


@cache
def load_scene_constants() -> dict[str, float]:
    """Load ``depth`` and ``passable`` of the scene's boxes as obstacles, metres (docs/specification/scene.md)."""
    return read_toml("prbench_benchmarks.prime_and_reach", "scene.toml", dict[str, float])


@cache
def load_citations() -> dict[str, str]:
    """Load the BibTeX of the study that defined the task (``study``) and of this toolkit (``toolkit``)."""
    return read_toml("prbench_benchmarks.prime_and_reach", "citations.toml", dict[str, str])


def dataset_names() -> tuple[str, ...]:
    """Names of prbench's own datasets and corpora, and of the datasets of installed packages, sorted."""
    return tuple(sorted({*datasets.own_datasets(), *datasets.readable_datasets()}))


_Loaded = TypeVar("_Loaded")


def read_toml(package: str, name: str, form: type[_Loaded]) -> _Loaded:
    """Read a TOML file of a data package as a data class.

    Raises:
        InputFileError: if the file does not fit the data class (naming the key).
    """
    return _convert_toml(resources.files(package) / name, form)


@foreign_input()
def _convert_toml(file: Traversable, form: type[_Loaded]) -> _Loaded:
    path = Path(str(file))
    return bounded.structured(path, bounded.read_toml(path), form)


_PACKAGE = "prbench_benchmarks"
_FILE = "benchmark.toml"


class AboutBenchmark(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The description of one benchmark.

    Attributes:
        case: What one case is, in words.
        answer: What a method answers to it, in words.
        judges: What judges the answers, in words.
        conditions: What a method may know, in words, by the name of the condition; in the order in which tables show
            them.
        build: Command that makes its tables.
        samples: Number of answers to each case, unless the user says another.
        batch_size: Number of cases a batch, unless the user says another.
        entry_points: Entry-point group in which packages offer its methods.
        methods: Methods that come with prbench, installed or not; no other package may use these names in the group.
        value: ``module:object`` of the benchmark's value.
        checks: ``module:function`` that returns the checks of its methods; empty where they cannot be checked.
        default: The benchmark that is meant where none is named.
    """

    name: str
    title: str
    case: str
    answer: str
    judges: str
    conditions: dict[str, str]
    build: str
    samples: int
    batch_size: int
    entry_points: str
    methods: tuple[str, ...]
    value: str
    checks: str = ""
    default: bool = False


@cache
def benchmarks() -> dict[str, AboutBenchmark]:
    """Return all benchmarks by name: the default one first, the others by name."""
    folders = [folder for folder in resources.files(_PACKAGE).iterdir() if (folder / _FILE).is_file()]
    found = [read_toml(f"{_PACKAGE}.{folder.name}", _FILE, AboutBenchmark) for folder in folders]
    return {about.name: about for about in sorted(found, key=lambda about: (not about.default, about.name))}


def find_benchmark(name: str) -> AboutBenchmark:
    """Find a benchmark by name.

    Raises:
        UsageError: for an unknown one, with the nearest known name.
    """
    known = benchmarks()
    if name not in known:
        raise UsageError(f"no benchmark '{name}'.{did_you_mean(name, known)} There are: {', '.join(known)}.")
    return known[name]


def default_benchmark() -> AboutBenchmark:
    """Return the benchmark that is meant where none is named."""
    return next(iter(benchmarks().values()))


def benchmark_of_group(entry_points: str) -> AboutBenchmark:
    """Return the benchmark whose methods are offered in an entry-point group.

    Raises:
        KeyError: if there is none; groups are named by prbench's own code.
    """
    return {about.entry_points: about for about in benchmarks().values()}[entry_points]
