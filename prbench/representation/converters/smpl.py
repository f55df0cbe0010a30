"""The 22 joints of SMPL, SMPL-H and SMPL-X: rotations in every form, parameters, and rest joints of a body model.

Source: docs/specification/humanml3d.md#body-model-parameters. Rotations become unit quaternions (w x y z) in NumPy
alone, so that a program of another Python needs no SciPy. Body models are licensed and never shipped. The 22 joints
need three arrays of one, which are read from plain arrays and never from a pickle: the rest joints are a linear
function of the shape, ``J_regressor @ (v_template + shapedirs @ betas)``. Forward kinematics in NumPy moves them.
:class:`SmplxModel` runs the package ``smplx`` instead.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, MissingExtraError, UsageError, did_you_mean
from prbench.files.arrays import Archive
from prbench.files.bounded import foreign_input
from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint

RotationForm = Literal[
    "axis-angle", "matrix", "quaternion-wxyz", "quaternion-xyzw", "6d-columns", "6d-rows", "6d-interleaved"
]
"""``6d-columns``: first column, then second column of the matrix (HumanML3D). ``6d-rows``: first row, then second row
(PyTorch3D, and with it MDM's SMPL representation). ``6d-interleaved``: the two columns side by side, row by row
(HMR, SPIN, VPoser: ``reshape(3, 2)``)."""
_NUMBERS: Mapping[str, int] = MappingProxyType(
    {
        "axis-angle": 3, "matrix": 9, "quaternion-wxyz": 4, "quaternion-xyzw": 4, "6d-columns": 6, "6d-rows": 6,
        "6d-interleaved": 6,
    }
)  # fmt: skip
"""Numbers that a rotation takes in each form."""
_UNIT_TOLERANCE = 0.05
"""Tolerance of a quaternion's length or a matrix's determinant; networks do not end on exact rotations."""
_NO_DIRECTION = 1e-6


def from_axis_angle(vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 4"]:
    """Quaternions of rotations about these axes by their lengths, radians."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    sine_over_angle = 0.5 * np.sinc(angle / (2 * np.pi))  # sin(angle / 2) / angle, 1/2 where there is no angle
    return np.concatenate([np.cos(angle / 2), sine_over_angle * vectors], axis=-1)


def from_matrices(matrices: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 4"]:
    """Quaternions of rotation matrices; their largest component is positive.

    With q the quaternion, 4 q q' is linear in the matrix. Any of its rows, divided by its length, is q; the one with
    the largest diagonal loses no digits (Shepperd, 1978).
    """
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(matrices, (-2, -1), (0, 1))
    rows = [
        [1 + a + e + i, h - f, c - g, d - b],
        [h - f, 1 + a - e - i, b + d, c + g],
        [c - g, b + d, 1 - a + e - i, f + h],
        [d - b, c + g, f + h, 1 - a - e + i],
    ]
    outer = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)  # (*batch, 4, 4)
    largest = np.diagonal(outer, axis1=-2, axis2=-1).argmax(axis=-1)
    chosen = np.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    return chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)


def to_matrices(quaternions: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrices of unit quaternions."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def numbers_of(form: str) -> int:
    """Numbers that a rotation takes in this form.

    Raises:
        UsageError: if the form is unknown.
    """
    if form not in _NUMBERS:
        raise UsageError(
            f"unknown form of rotations '{form}'.{did_you_mean(form, _NUMBERS)} Choose one of: {', '.join(_NUMBERS)}."
        )
    return _NUMBERS[form]


def quaternions_of(
    values: Float[np.ndarray, "frames numbers"], form: RotationForm, *, source: Path | str = "rotations"
) -> Float[np.ndarray, "frames joints 4"]:
    """Unit quaternions (w x y z) of each frame from its numbers, joint after joint.

    Args:
        values: As many numbers as ``joints`` rotations take.
        form: How they are written; axis-angle in radians.
        source: Name that messages begin with.

    Raises:
        UsageError: if the form is unknown.
        InputFileError: if the numbers do not divide into rotations, are not finite, or are far from any rotation
            (quaternions of another length, angles that look like degrees).
    """
    size = numbers_of(form)
    if values.shape[1] % size or not values.shape[1]:
        raise InputFileError(
            source, "", expected=f"a multiple of {size} numbers a frame ({form})", found=str(values.shape[1])
        )
    if not np.isfinite(values).all():
        frame = int(np.argwhere(~np.isfinite(values))[0, 0])
        raise InputFileError(source, f"frame {frame}", expected="finite numbers", found="NaN or infinity")
    each = values.astype(np.float64).reshape(-1, size)
    return _READ[form](each, source).reshape(len(values), -1, 4)


def _axis_angle(values: np.ndarray, source: Path | str) -> np.ndarray:
    largest = float(np.linalg.norm(values, axis=-1).max(initial=0.0))
    if largest > 4 * np.pi:
        raise InputFileError(
            source,
            "",
            expected="axis-angle in radians",
            found=f"an angle of {largest:.0f}",
            remedy="These look like degrees, or like another form of rotations.",
        )
    return from_axis_angle(values)


def _quaternion(values: np.ndarray, source: Path | str) -> np.ndarray:
    """Unit quaternions from such that a network has put out, w first."""
    lengths = np.linalg.norm(values, axis=-1)
    if np.abs(lengths - 1).max(initial=0.0) > _UNIT_TOLERANCE:
        wrong = float(lengths[np.abs(lengths - 1).argmax()])
        raise InputFileError(source, "", expected="unit quaternions", found=f"one of the length {wrong:.3g}")
    return values / lengths[:, None]


def _matrix(values: np.ndarray, source: Path | str) -> np.ndarray:
    matrices = values.reshape(-1, 3, 3)
    determinants = np.linalg.det(matrices)
    if np.abs(determinants - 1).max(initial=0.0) > 3 * _UNIT_TOLERANCE:
        wrong = float(determinants[np.abs(determinants - 1).argmax()])
        raise InputFileError(
            source, "", expected="rotation matrices", found=f"a matrix whose determinant is {wrong:.3g}"
        )
    return from_matrices(_orthonormal(matrices[..., 0], matrices[..., 1], source))


def _orthonormal(first: np.ndarray, second: np.ndarray, source: Path | str) -> np.ndarray:
    """Rotation matrices whose first two columns span the given ones (Gram-Schmidt)."""
    length = np.linalg.norm(first, axis=-1, keepdims=True)
    first = first / np.maximum(length, 1e-12)
    across = second - (first * second).sum(axis=-1, keepdims=True) * first
    width = np.linalg.norm(across, axis=-1, keepdims=True)
    if min(length.min(initial=1.0), width.min(initial=1.0)) < _NO_DIRECTION:
        raise InputFileError(
            source,
            "",
            expected="two directions a rotation",
            found="two directions that lie along one another, or none",
            remedy="Is it another of the 6d forms?",
        )
    across = across / width
    return np.stack([first, across, np.cross(first, across)], axis=-1)


_READ: Mapping[str, Callable[[np.ndarray, Path | str], np.ndarray]] = MappingProxyType(
    {
        "axis-angle": _axis_angle,
        "matrix": _matrix,
        "quaternion-wxyz": _quaternion,
        "quaternion-xyzw": lambda values, source: _quaternion(values[:, [3, 0, 1, 2]], source),
        "6d-columns": lambda values, source: from_matrices(_orthonormal(values[:, :3], values[:, 3:], source)),
        "6d-rows": lambda values, source: from_matrices(
            np.swapaxes(_orthonormal(values[:, :3], values[:, 3:], source), -1, -2)
        ),
        "6d-interleaved": lambda values, source: from_matrices(_orthonormal(values[:, ::2], values[:, 1::2], source)),
    }
)


_PARAMETERS = "parameters"
"""Name in messages of arrays that come from no file."""

_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate")


@dataclass(frozen=True)
class SmplParameters:
    """One motion. Rotations of the 22 body joints, of the pelvis in the world and of the others in their parents."""

    rotations: Float[np.ndarray, "frames 22 4"]
    """Unit quaternions, w x y z."""
    transl: Float[np.ndarray, "frames 3"]
    """The model's translation, metres: the pelvis lies at this plus the *rest pelvis*, which is not the origin."""
    betas: Float[np.ndarray, " shapes"] | None = None
    """Shape of the person; None for the model's mean body."""
    gender: str | None = None
    """Model that the shape belongs to: ``neutral``, ``male`` or ``female``; None if unknown."""
    fps: float | None = None
    """Frames a second, where a file says it."""

    @classmethod
    def from_arrays(
        cls,
        *,
        global_orient: Float[np.ndarray, "_frames ..."],
        body_pose: Float[np.ndarray, "_frames ..."],
        transl: Float[np.ndarray, "frames 3"],
        betas: Float[np.ndarray, "..."] | None = None,
        form: RotationForm = "axis-angle",
        gender: str | None = None,
        source: Path | str = _PARAMETERS,
    ) -> SmplParameters:
        """Read the arguments that the package ``smplx`` has, under its names.

        Args:
            global_orient: Rotation of the pelvis in the world; any shape of the right size a frame.
            body_pose: Rotations of joints 1 to 21 (SMPL-H, SMPL-X) or 1 to 23 (SMPL) in their parents; those of the
                hands are left away, they move none of the 22 joints.
            transl: Metres.
            betas: (shapes,) or (frames, shapes); of several rows the mean is taken, because a body keeps its shape.
            form: How rotations are written; the same for both.
            gender: Of the model.
            source: Name that messages begin with.

        Raises:
            InputFileError: if an array has another size, or a number is no rotation.
        """
        frames = len(transl)
        poses = np.concatenate(
            [_flat(global_orient, frames, "global_orient", source), _flat(body_pose, frames, "body_pose", source)],
            axis=1,
        )
        return cls.from_poses(poses, transl, betas=betas, form=form, gender=gender, source=source)

    @classmethod
    def from_poses(
        cls,
        poses: Float[np.ndarray, "_frames ..."],
        transl: Float[np.ndarray, "frames 3"],
        *,
        betas: Float[np.ndarray, "..."] | None = None,
        form: RotationForm = "axis-angle",
        gender: str | None = None,
        source: Path | str = _PARAMETERS,
    ) -> SmplParameters:
        """Read one array of rotations, pelvis first (``poses`` of AMASS: 72, 156 or 165 numbers a frame).

        Args:
            poses: At least 22 rotations a frame, in the order of SMPL; what follows is left away.
            transl: ``trans`` of AMASS, metres.
            betas: As in :meth:`from_arrays`.
            form: How rotations are written.
            gender: Of the model.
            source: Name that messages begin with.

        Raises:
            InputFileError: if an array has another size, or a number is no rotation.
        """
        numbers = numbers_of(form)
        flat = _flat(poses, len(transl), "poses", source)
        if flat.shape[1] < N_JOINTS * numbers or flat.shape[1] % numbers:
            raise InputFileError(
                source,
                "poses",
                expected=f"{N_JOINTS} or more rotations of {numbers} numbers a frame ({form})",
                found=f"{flat.shape[1]} numbers",
                remedy="Name the form of the rotations, and give global_orient and body_pose both.",
            )
        if not len(transl) or transl.shape[1:] != (3,) or not np.isfinite(transl).all():
            raise InputFileError(source, "transl", expected="finite (frames, 3)", found=str(transl.shape))
        rotations = quaternions_of(flat[:, : N_JOINTS * numbers], form, source=source)
        return cls(rotations, transl.astype(np.float64), _one_shape(betas, source), gender)


@foreign_input()
def read_amass(path: Path) -> SmplParameters:
    """A motion in the layout of AMASS: SMPL-H (``mocap_framerate``) or SMPL-X (``mocap_frame_rate``); Z up.

    Raises:
        InputFileError: if the file is missing, no archive of plain arrays, or lacks ``poses`` or ``trans``.
    """
    archive = Archive(path)
    archive.require(("poses", "trans"))
    arrays = archive.load(("poses", "trans", "betas", "gender", *_RATE_KEYS))
    gender = _text(arrays["gender"]) if "gender" in arrays else None
    rates = [_rate(path, key, arrays[key]) for key in _RATE_KEYS if key in arrays]
    parameters = SmplParameters.from_poses(
        arrays["poses"], arrays["trans"], betas=arrays.get("betas"), gender=gender, source=path
    )
    return replace(parameters, fps=rates[0] if rates else None)


def _rate(path: Path, key: str, value: np.ndarray) -> float:
    if value.size != 1 or value.dtype.kind not in "fiu":
        raise InputFileError(path, key, expected="a number", found=f"shape {value.shape} of {value.dtype}")
    return float(value.reshape(-1)[0])


def _text(value: np.ndarray) -> str:
    """A word that NumPy holds as text or as bytes."""
    return value.item().decode("ascii", "replace") if value.dtype.kind == "S" else str(value)


def _flat(values: np.ndarray, frames: int, name: str, source: Path | str) -> np.ndarray:
    if values.ndim < 2 or len(values) != frames:
        raise InputFileError(
            source, name, expected=f"{frames} frames of rotations, as many as transl", found=str(values.shape)
        )
    return values.reshape(frames, -1)


def _one_shape(betas: np.ndarray | None, source: Path | str) -> np.ndarray | None:
    if betas is None:
        return None
    if betas.ndim not in (1, 2) or not betas.size or not np.isfinite(betas).all():
        raise InputFileError(source, "betas", expected="finite (shapes,) or (frames, shapes)", found=str(betas.shape))
    return betas.reshape(-1, betas.shape[-1]).astype(np.float64).mean(axis=0)


REGRESSOR = "J_regressor"
TEMPLATE = "v_template"
SHAPES = "shapedirs"
SMPL_JOINTS = 24
SMPLH_JOINTS = 52
SMPLX_JOINTS = 55
"""Rows of the regressor, by which the three models are told apart."""

HOW_TO_CONVERT = (
    "prbench opens no pickles. Convert the licensed file once, in the environment of its own tools (a .pkl of SMPL"
    " needs chumpy there): python -c \"import numpy, pickle, sys; m = pickle.load(open(sys.argv[1], 'rb'),"
    " encoding='latin1'); numpy.savez(sys.argv[2], **{k: numpy.asarray(v.todense() if hasattr(v, 'todense') else v)"
    " for k, v in m.items() if k in ('J_regressor', 'v_template', 'shapedirs', 'posedirs', 'weights', 'f',"
    " 'kintree_table', 'hands_componentsl', 'hands_componentsr', 'hands_meanl', 'hands_meanr', 'lmk_faces_idx',"
    " 'lmk_bary_coords')})\" MODEL.pkl MODEL.npz"
)


@dataclass(frozen=True)
class RestJoints:
    """The 22 joints of a body model in its rest pose, linear in the shape. Model frame: x left, y up, z forward."""

    template: Float[np.ndarray, "22 3"]
    """Rest joints of the mean shape, metres."""
    directions: Float[np.ndarray, "22 3 shapes"]
    """Displacements that each shape number adds, metres."""

    def of(self, betas: Float[np.ndarray, " shapes"] | None) -> Float[np.ndarray, "22 3"]:
        """Rest joints of one shape, metres; fewer numbers than the model has leave the others at 0.

        Raises:
            InputFileError: if there are more shape numbers than the model knows.
        """
        if betas is None:
            return self.template
        known = self.directions.shape[-1]
        if len(betas) > known:
            if np.any(betas[known:]):
                raise InputFileError(
                    "betas",
                    "",
                    expected=f"at most the {known} shape numbers of the body model",
                    found=str(len(betas)),
                    remedy="The shape belongs to another model (SMPL-H 'extended' has 16); take the model that it was"
                    " fitted with.",
                )
            betas = betas[:known]
        return self.template + self.directions[..., : len(betas)] @ betas.astype(np.float64)

    @classmethod
    def fixed(cls, joints: Float[np.ndarray, "22 3"]) -> RestJoints:
        """Rest joints that are known without any model file: T-pose joints of the one body that a method knows."""
        return cls(joints.astype(np.float64), np.zeros((N_JOINTS, 3, 0)))


@foreign_input()
def read_rest_joints(path: Path) -> RestJoints:
    """The rest joints of a body model in ``.npz`` form.

    Args:
        path: ``SMPLX_NEUTRAL.npz``, ``smplh/neutral/model.npz``, or what :data:`HOW_TO_CONVERT` writes.

    Raises:
        InputFileError: if the file is missing, a pickle, no archive of plain arrays, or its arrays do not fit together.
    """
    arrays = read_plain_arrays(path, (REGRESSOR, TEMPLATE, SHAPES))
    regressor, template, shapes = (arrays[key].astype(np.float64) for key in (REGRESSOR, TEMPLATE, SHAPES))
    points = len(template)
    fits = (
        template.shape == (points, 3)
        and regressor.ndim == 2
        and regressor.shape[0] >= N_JOINTS
        and regressor.shape[1] == points
        and shapes.ndim == 3
        and shapes.shape[:2] == (points, 3)
    )
    if not fits or not all(np.isfinite(array).all() for array in (regressor, template, shapes)):
        raise InputFileError(
            path,
            "",
            expected=f"finite v_template (v, 3), J_regressor (at least {N_JOINTS}, v) and shapedirs (v, 3, shapes)",
            found=f"{template.shape}, {regressor.shape} and {shapes.shape}",
            remedy="This is the model of another body.",
        )
    body = regressor[:N_JOINTS]
    shapes = shapes[..., : _shape_numbers(regressor.shape[0], shapes.shape[2])]
    return RestJoints(body @ template, np.einsum("jv,vck->jck", body, shapes))


def _shape_numbers(joints: int, columns: int) -> int:
    """Columns of ``shapedirs`` that are shape: in SMPL-X those of the face's expression follow them."""
    if joints != SMPLX_JOINTS:
        return columns
    return 300 if columns >= 400 else min(columns, 10)


@foreign_input()
def read_plain_arrays(path: Path, needed: Iterable[str], optional: Iterable[str] = ()) -> dict[str, np.ndarray]:
    """Arrays of a body model by name; those that hold Python objects are never opened.

    Raises:
        InputFileError: if the file is missing, a pickle, or lacks one of the needed arrays.
    """
    path = path.expanduser()
    if not path.exists():
        raise InputFileError(
            path,
            "",
            expected="your own body model",
            found="no such file",
            remedy="Download it from the page of the model (smpl.is.tue.mpg.de, mano.is.tue.mpg.de,"
            " smpl-x.is.tue.mpg.de) after accepting its licence; prbench ships none.",
        )
    if path.suffix == ".pkl":
        raise InputFileError(path, "", expected="an .npz archive", found="a pickle", remedy=HOW_TO_CONVERT)
    needed = tuple(needed)
    archive = Archive(path, remedy=HOW_TO_CONVERT)
    archive.require(needed)
    return archive.load((*needed, *optional))


def smpl_joints(parameters: SmplParameters, rest: RestJoints) -> Float[np.ndarray, "frames 22 3"]:
    """Joints as the body model has them; blend shapes of the surface move none of them, so this is exact.

    SMPL, SMPL-H and SMPL-X share the order of these 22 joints, not their rest joints: take the model that the
    parameters were made for.

    Args:
        parameters: The motion.
        rest: Rest joints of the model.

    Returns:
        World of the parameters (AMASS: Z up), metres, at their rate.

    Raises:
        InputFileError: if there are more shape numbers than the model knows.
    """
    body = rest.of(parameters.betas)
    local = to_matrices(parameters.rotations)
    world = [local[:, Joint.PELVIS]]
    joints = [parameters.transl + body[Joint.PELVIS]]
    for joint in range(1, N_JOINTS):
        parent = PARENTS[joint]
        joints.append(joints[parent] + world[parent] @ (body[joint] - body[parent]))
        world.append(world[parent] @ local[:, joint])
    return np.stack(joints, axis=1)


_BODY = (REGRESSOR, TEMPLATE, SHAPES, "posedirs", "weights", "f", "kintree_table")
_HANDS = ("hands_componentsl", "hands_componentsr", "hands_meanl", "hands_meanr")
_FACE = ("lmk_faces_idx", "lmk_bary_coords")
_AT_ONCE = 64  # frames whose surface is held in memory
_MOST_SHAPES = 300  # the package takes as many of them as the model has
_SURFACE_POINTS = (
    "nose", "reye", "leye", "rear", "lear", "LBigToe", "LSmallToe", "LHeel", "RBigToe", "RSmallToe", "RHeel",
)  # fmt: skip
_FINGERS = tuple(f"{side}{finger}" for side in "lr" for finger in ("thumb", "index", "middle", "ring", "pinky"))
_ANY_VERTEX = dict.fromkeys((*_SURFACE_POINTS, *_FINGERS), 0)
"""Surface points that the package appends to the joints; they come behind the 22 and are cut away."""


@dataclass(frozen=True, eq=False)
class SmplxModel:
    """One body model as the package holds it; read it once, it is large."""

    layer: Any
    """``SMPLLayer``, ``SMPLHLayer`` or ``SMPLXLayer``, double precision."""

    @classmethod
    @foreign_input()
    def read(cls, model: Path) -> SmplxModel:
        """The user's own model.

        Args:
            model: SMPL (24 joints), SMPL-H (52) or SMPL-X (55) as ``.npz`` of plain arrays; which one, the file tells.

        Raises:
            MissingExtraError: if ``smplx`` is not installed.
            InputFileError: if the model cannot be read without unpickling, or is another one.
        """
        try:
            import smplx
            import torch
        except ImportError as error:
            raise MissingExtraError("smplx", "smplx", "the SMPL converter through smplx") from error
        arrays = read_plain_arrays(model, _BODY, (*_HANDS, *_FACE))
        joints = arrays[REGRESSOR].shape[0] if arrays[REGRESSOR].ndim == 2 else 0
        needed = {SMPL_JOINTS: (), SMPLH_JOINTS: _HANDS, SMPLX_JOINTS: (*_HANDS, *_FACE)}
        if joints not in needed:
            raise InputFileError(
                model,
                REGRESSOR,
                expected="a regressor of 24 (SMPL), 52 (SMPL-H) or 55 (SMPL-X) joints",
                found=str(arrays[REGRESSOR].shape),
            )
        missing = [name for name in needed[joints] if name not in arrays]
        if missing:
            raise InputFileError(
                model,
                "",
                expected=f"an array '{missing[0]}', which smplx wants of a model of {joints} joints",
                found="none",
                remedy="smpl_joints needs no hands and no face.",
            )
        with contextlib.redirect_stdout(io.StringIO()):  # it prints warnings, and stdout may belong to a protocol
            return cls(_layer(smplx, torch, arrays))

    def joints(self, parameters: SmplParameters) -> Float[np.ndarray, "frames 22 3"]:
        """Joints as the package computes them; hands and face rest.

        Returns:
            World of the parameters, metres, at their rate.

        Raises:
            InputFileError: if there are more shape numbers than the package takes from this model: 10, or 300 where
                the file has as many.
        """
        import torch

        known = self.layer.num_betas
        betas = np.zeros(known)
        given = np.zeros(0) if parameters.betas is None else parameters.betas
        if np.any(given[known:]):
            raise InputFileError(
                "betas",
                "",
                expected=f"at most {known} shape numbers: the package smplx takes no more from this model",
                found=str(len(given)),
                remedy="smpl_joints takes all that the model has.",
            )
        betas[: len(given[:known])] = given[:known]
        return np.concatenate(
            [
                self._posed(torch, betas, parameters.rotations[first:stop], parameters.transl[first:stop])
                for first, stop in ((first, first + _AT_ONCE) for first in range(0, len(parameters.transl), _AT_ONCE))
            ]
        )

    def _posed(self, torch: Any, betas: np.ndarray, rotations: np.ndarray, transl: np.ndarray) -> np.ndarray:
        frames = len(rotations)
        expressions = getattr(self.layer, "num_expression_coeffs", 0)
        face = {"expression": torch.zeros((frames, expressions), dtype=torch.float64)} if expressions else {}
        turned = torch.from_numpy(_with_resting_hands(rotations, self.layer.NUM_BODY_JOINTS))
        with torch.no_grad():
            posed = self.layer(
                betas=torch.from_numpy(np.tile(betas, (frames, 1))),
                global_orient=turned[:, :1],
                body_pose=turned[:, 1:],
                transl=torch.from_numpy(transl),
                **face,
            )
        return posed.joints[:, :N_JOINTS].numpy()


def _layer(smplx: Any, torch: Any, arrays: dict[str, np.ndarray]) -> Any:
    """The package's own model, from numbers alone."""
    from smplx.utils import Struct

    joints = arrays[REGRESSOR].shape[0]
    common = {"dtype": torch.float64, "num_betas": _MOST_SHAPES}
    if joints == SMPLX_JOINTS:  # this class takes no arrays, only a file: one that holds nothing but numbers
        with tempfile.TemporaryDirectory() as folder:
            plain = Path(folder) / "numbers.npz"
            np.savez(plain, allow_pickle=False, **arrays)
            return smplx.SMPLXLayer(str(plain), ext="npz", use_pca=False, **common)
    given = {"data_struct": Struct(**arrays), "vertex_ids": _ANY_VERTEX, **common}
    if joints == SMPLH_JOINTS:
        return smplx.SMPLHLayer("", use_pca=False, **given)
    return smplx.SMPLLayer("", **given)


def _with_resting_hands(rotations: np.ndarray, body_joints: int) -> np.ndarray:
    """Rotation matrices of the pelvis and as many body joints as the model has; the hands of SMPL rest."""
    turned = np.tile(np.eye(3), (len(rotations), body_joints + 1, 1, 1))
    from scipy.spatial.transform import Rotation  # late: 0.2 s that whoever only names a converter does not need

    matrices = Rotation.from_quat(rotations.reshape(-1, 4), scalar_first=True).as_matrix()
    turned[:, :N_JOINTS] = matrices.reshape(-1, N_JOINTS, 3, 3)
    return turned
