"""The 22 joints of SMPL, SMPL-H and SMPL-X: rotations in every form, parameters, and rest joints of a body model.

Source: docs/specification/humanml3d.md#body-model-parameters. Rotations become unit quaternions (w x y z) in NumPy
alone, so that a program of another Python needs no SciPy. Body models are licensed and never shipped. The 22 joints
need three arrays of one, which are read from plain arrays and never from a pickle: the rest joints are a linear
function of the shape, ``J_regressor @ (v_template + shapedirs @ betas)``. Forward kinematics in NumPy moves them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.files.arrays import Archive
from prbench.files.bounded import foreign_input, require, require_rows
from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint, forward_kinematics, rotation_matrices

# ``6d-columns``: first column, then second column of the matrix (HumanML3D). ``6d-rows``: first row, then second row
# (PyTorch3D, and with it MDM's SMPL representation). ``6d-interleaved``: the two columns side by side, row by row (HMR,
# SPIN, VPoser: ``reshape(3, 2)``).
RotationForm = Literal[
    "axis-angle", "matrix", "quaternion-wxyz", "quaternion-xyzw", "6d-columns", "6d-rows", "6d-interleaved"
]
# Tolerance of a quaternion's length or a matrix's determinant; networks do not end on exact rotations.
_UNIT_TOLERANCE = 0.05
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


# Maps each form to the numbers that a rotation takes in it.
_FORMS: Mapping[str, int] = MappingProxyType(
    {
        "axis-angle": 3,
        "matrix": 9,
        "quaternion-wxyz": 4,
        "quaternion-xyzw": 4,
        "6d-columns": 6,
        "6d-rows": 6,
        "6d-interleaved": 6,
    }
)


def numbers_of(form: str) -> int:
    """Numbers that a rotation takes in this form.

    Raises:
        UsageError: if the form is unknown.
    """
    if form not in _FORMS:
        raise UsageError(
            f"unknown form of rotations '{form}'.{did_you_mean(form, _FORMS)} Choose one of: {', '.join(_FORMS)}."
        )
    return _FORMS[form]


def quaternions_of(
    values: Float[np.ndarray, "frames numbers"], form: RotationForm, *, source: Path | str = "rotations"
) -> Float[np.ndarray, "frames joints 4"]:
    """Return unit quaternions (w x y z) of each frame from its numbers, joint after joint.

    Args:
        values: The numbers of each frame, those of one rotation after those of another.
        form: How they are written; axis-angle in radians.
        source: Name that messages begin with.

    Raises:
        UsageError: if the form is unknown.
        InputFileError: if the numbers do not divide into rotations, are not finite, or are far from any rotation
            (quaternions of another length, angles that look like degrees).
    """
    size = numbers_of(form)
    fits = values.shape[1] % size == 0 and values.shape[1] > 0
    require(source, (fits, "", f"a multiple of {size} numbers a frame ({form})", values.shape[1], ""))
    require_rows(source, ~np.isfinite(values).all(axis=1), "finite numbers", "NaN or infinity", place="frame", first=0)
    each = values.astype(np.float64).reshape(-1, size)

    def require_ones(numbers: np.ndarray, tolerance: float, expected: str, found: str) -> None:
        apart = np.abs(numbers - 1)
        if apart.max(initial=0.0) > tolerance:
            raise InputFileError(source, "", expected=expected, found=f"{found} {numbers[apart.argmax()]:.3g}")

    if form == "axis-angle":
        largest = float(np.linalg.norm(each, axis=-1).max(initial=0.0))
        remedy = "These look like degrees, or like another form of rotations."
        require(source, (largest <= 4 * np.pi, "", "axis-angle in radians", f"an angle of {largest:.0f}", remedy))
        quaternions = from_axis_angle(each)
    elif size == 4:
        if form == "quaternion-xyzw":
            each = each[:, [3, 0, 1, 2]]
        lengths = np.linalg.norm(each, axis=-1)
        require_ones(lengths, _UNIT_TOLERANCE, "unit quaternions", "one of the length")
        quaternions = each / lengths[:, None]
    else:
        first, second = each[:, :3], each[:, 3:6]
        if form == "matrix":
            determinants = np.linalg.det(each.reshape(-1, 3, 3))
            require_ones(determinants, 3 * _UNIT_TOLERANCE, "rotation matrices", "a matrix whose determinant is")
            first, second = each[:, ::3], each[:, 1::3]
        elif form == "6d-interleaved":
            first, second = each[:, ::2], each[:, 1::2]
        # Two columns become a rotation matrix (Gram-Schmidt); what a network puts out is no exact rotation.
        length = np.linalg.norm(first, axis=-1, keepdims=True)
        first = first / np.maximum(length, 1e-12)
        across = second - (first * second).sum(axis=-1, keepdims=True) * first
        width = np.linalg.norm(across, axis=-1, keepdims=True)
        least = min(length.min(initial=1.0), width.min(initial=1.0))
        found = "two directions that lie along one another, or none"
        remedy = "Is it another of the 6d forms?"
        require(source, (least >= _NO_DIRECTION, "", "two directions a rotation", found, remedy))
        across = across / width
        matrices = np.stack([first, across, np.cross(first, across)], axis=-1)
        quaternions = from_matrices(np.swapaxes(matrices, -1, -2) if form == "6d-rows" else matrices)
    return quaternions.reshape(len(values), -1, 4)


# Name in messages of arrays that come from no file.
_PARAMETERS = "parameters"

_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate")


@dataclass(frozen=True)
class SmplParameters:
    """One motion. Rotations of the 22 body joints, of the pelvis in the world and of the others in their parents.

    Attributes:
        rotations: Unit quaternions, w x y z.
        transl: The model's translation, metres: the pelvis lies at this plus the *rest pelvis*, which is not the
            origin.
        betas: Shape of the person; None for the model's mean body.
        gender: Model that the shape belongs to: ``neutral``, ``male`` or ``female``; None if unknown.
        fps: Frames a second, where a file says it.
    """

    rotations: Float[np.ndarray, "frames 22 4"]
    transl: Float[np.ndarray, "frames 3"]
    betas: Float[np.ndarray, " shapes"] | None = None
    gender: str | None = None
    fps: float | None = None

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
            gender: Gender of the model.
            source: Name that messages begin with.

        Raises:
            InputFileError: if an array has another size, or a number is no rotation.
        """
        parts = (("global_orient", global_orient), ("body_pose", body_pose))
        poses = np.concatenate([_flat(values, len(transl), name, source) for name, values in parts], axis=1)
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
            poses: 22 or more rotations a frame, in the order of SMPL; what follows is left away.
            transl: ``trans`` of AMASS, metres.
            betas: See :meth:`from_arrays`.
            form: How rotations are written.
            gender: Gender of the model.
            source: Name that messages begin with.

        Raises:
            InputFileError: if an array has another size, or a number is no rotation.
        """
        numbers = numbers_of(form)
        flat = _flat(poses, len(transl), "poses", source)
        expected = f"{N_JOINTS} or more rotations of {numbers} numbers a frame ({form})"
        enough = flat.shape[1] >= N_JOINTS * numbers and flat.shape[1] % numbers == 0
        remedy = "Name the form of the rotations, and give global_orient and body_pose both."
        moves = len(transl) > 0 and transl.shape[1:] == (3,) and np.isfinite(transl).all()
        require(source, (enough, "poses", expected, f"{flat.shape[1]} numbers", remedy))
        require(source, (moves, "transl", "finite (frames, 3)", transl.shape, ""))
        if betas is not None:
            shaped = betas.ndim in (1, 2) and betas.size > 0 and np.isfinite(betas).all()
            require(source, (shaped, "betas", "finite (shapes,) or (frames, shapes)", betas.shape, ""))
            betas = betas.reshape(-1, betas.shape[-1]).astype(np.float64).mean(axis=0)
        rotations = quaternions_of(flat[:, : N_JOINTS * numbers], form, source=source)
        return cls(rotations, transl.astype(np.float64), betas, gender)


def _flat(values: np.ndarray, frames: int, name: str, source: Path | str) -> np.ndarray:
    expected = f"{frames} frames of rotations, as many as transl"
    require(source, (values.ndim >= 2 and len(values) == frames, name, expected, values.shape, ""))
    return values.reshape(frames, -1)


@foreign_input()
def read_amass(path: Path) -> SmplParameters:
    """Return a motion in the layout of AMASS: SMPL-H (``mocap_framerate``) or SMPL-X (``mocap_frame_rate``); Z up.

    Raises:
        InputFileError: if the file is missing, no archive of plain arrays, or lacks ``poses`` or ``trans``.
    """
    archive = Archive(path)
    archive.require(("poses", "trans"))
    arrays = archive.load(("poses", "trans", "betas", "gender", *_RATE_KEYS))
    gender = arrays.get("gender")
    if gender is not None:  # NumPy holds it as text or as bytes
        gender = gender.item().decode("ascii", "replace") if gender.dtype.kind == "S" else str(gender)
    fps = None
    for key in (key for key in _RATE_KEYS if key in arrays):
        value = arrays[key]
        if value.size != 1 or value.dtype.kind not in "fiu":
            raise InputFileError(path, key, expected="a number", found=f"shape {value.shape} of {value.dtype}")
        fps = float(value.reshape(-1)[0]) if fps is None else fps
    parameters = SmplParameters.from_poses(
        arrays["poses"], arrays["trans"], betas=arrays.get("betas"), gender=gender, source=path
    )
    return replace(parameters, fps=fps)


REGRESSOR = "J_regressor"
TEMPLATE = "v_template"
SHAPES = "shapedirs"
# Rows of the regressor, by which this model is told from SMPL, which has 24, and from SMPL-H, which has 52.
SMPLX_JOINTS = 55

HOW_TO_CONVERT = (
    "prbench opens no pickles. Convert the licensed file once, in the environment of its own tools (a .pkl of SMPL"
    " needs chumpy there): python -c \"import numpy, pickle, sys; m = pickle.load(open(sys.argv[1], 'rb'),"
    " encoding='latin1'); numpy.savez(sys.argv[2], **{k: numpy.asarray(v.todense() if hasattr(v, 'todense') else v)"
    " for k, v in m.items() if k in ('J_regressor', 'v_template', 'shapedirs')})\" MODEL.pkl MODEL.npz"
)
_DOWNLOAD = (
    "Download it from the page of the model (smpl.is.tue.mpg.de, mano.is.tue.mpg.de, smpl-x.is.tue.mpg.de) after"
    " accepting its licence; prbench ships none."
)


@dataclass(frozen=True)
class RestJoints:
    """The 22 joints of a body model in its rest pose, linear in the shape. Model frame: x left, y up, z forward.

    Attributes:
        template: Rest joints of the mean shape, metres.
        directions: Displacements that each shape number adds, metres.
    """

    template: Float[np.ndarray, "22 3"]
    directions: Float[np.ndarray, "22 3 shapes"]

    def of(self, betas: Float[np.ndarray, " shapes"] | None) -> Float[np.ndarray, "22 3"]:
        """Rest joints of one shape, metres; fewer numbers than the model has leave the others at 0.

        Raises:
            InputFileError: if there are more shape numbers than the model knows.
        """
        if betas is None:
            return self.template
        known = self.directions.shape[-1]
        if len(betas) > known:
            expected = f"at most the {known} shape numbers of the body model"
            remedy = (
                "The shape belongs to another model (SMPL-H 'extended' has 16); take the one that it was fitted with."
            )
            require("betas", (not np.any(betas[known:]), "", expected, len(betas), remedy))
            betas = betas[:known]
        return self.template + self.directions[..., : len(betas)] @ betas.astype(np.float64)

    @classmethod
    def fixed(cls, joints: Float[np.ndarray, "22 3"]) -> RestJoints:
        """Rest joints that are known without any model file: T-pose joints of the one body that a method knows."""
        return cls(joints.astype(np.float64), np.zeros((N_JOINTS, 3, 0)))


@foreign_input()
def read_rest_joints(path: Path, *, joints: int | None = None, how_to_get: str = _DOWNLOAD) -> RestJoints:
    """Return the rest joints of a body model in ``.npz`` form; arrays that hold Python objects are never opened.

    Args:
        path: ``SMPLX_NEUTRAL.npz``, ``smplh/neutral/model.npz``, or what :data:`HOW_TO_CONVERT` writes.
        joints: Joints of the whole model, where only one model will do: 24 of SMPL, 52 of SMPL-H, 55 of SMPL-X.
        how_to_get: What to do where there is no file, for the message.

    Raises:
        InputFileError: if the file is missing, a pickle, no archive of plain arrays, or its arrays do not fit together.
    """
    path = path.expanduser()
    require(path, (path.exists(), "", "your own body model", "no such file", how_to_get))
    require(path, (path.suffix != ".pkl", "", "an .npz archive", "a pickle", HOW_TO_CONVERT))
    archive = Archive(path, remedy=HOW_TO_CONVERT)
    archive.require((REGRESSOR, TEMPLATE, SHAPES))
    arrays = archive.load((REGRESSOR, TEMPLATE, SHAPES))
    regressor, template, shapes = (arrays[key].astype(np.float64) for key in (REGRESSOR, TEMPLATE, SHAPES))
    points = len(template)
    fits = (
        template.shape == (points, 3)
        and regressor.ndim == 2
        and (regressor.shape[0] >= N_JOINTS if joints is None else regressor.shape[0] == joints)
        and regressor.shape[1] == points
        and shapes.ndim == 3
        and shapes.shape[:2] == (points, 3)
    )
    fits = fits and all(np.isfinite(array).all() for array in (regressor, template, shapes))
    rows = joints or f"at least {N_JOINTS}"
    expected = f"finite v_template (v, 3), J_regressor ({rows}, v) and shapedirs (v, 3, shapes)"
    found = f"{template.shape}, {regressor.shape} and {shapes.shape}"
    require(path, (fits, "", expected, found, "This is the model of another body."))
    if len(regressor) == SMPLX_JOINTS:  # columns of the face's expression follow those of the shape
        shapes = shapes[..., : 300 if shapes.shape[2] >= 400 else 10]
    body = regressor[:N_JOINTS]
    return RestJoints(body @ template, np.einsum("jv,vck->jck", body, shapes))


def pose_body(
    rest: Float[np.ndarray, "22 3"], pelvis: Float[np.ndarray, "frames 3"], rotations: Float[np.ndarray, "frames 22 4"]
) -> tuple[Float[np.ndarray, "frames 22 3"], Float[np.ndarray, "frames 22 3 3"]]:
    """Positions and world rotations of the 22 joints.

    Args:
        rest: Joints in the rest pose; only their differences matter, because the pelvis is placed by ``pelvis``.
        pelvis: Position of the pelvis joint in the world, metres.
        rotations: Unit quaternions, w x y z: of the pelvis in the world, of the others in their parents.
    """
    return forward_kinematics(rest - rest[list(PARENTS)], pelvis, rotation_matrices(rotations), PARENTS)


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
    return pose_body(body, parameters.transl + body[Joint.PELVIS], parameters.rotations)[0]
