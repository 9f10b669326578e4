"""Rotations, frames and poses of ``planner.spatial`` against their definitions."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from planner.spatial import SE3, contact_frames, pose_from_wxyz, pose_to_wxyz, rotation_angle, skew


@pytest.mark.parametrize("seed", range(3))
def test_a_skew_matrix_is_the_product_with_its_vector(seed: int) -> None:
    a, b = np.random.default_rng(seed).normal(size=(2, 5, 3))
    np.testing.assert_allclose((skew(a) @ b[:, :, None])[:, :, 0], np.cross(a, b), atol=1e-14)


def test_frames_of_contacts_are_right_handed_around_their_normals() -> None:
    normals = np.vstack([np.eye(3), -np.eye(3), np.random.default_rng(0).normal(size=(20, 3))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    frames = contact_frames(normals)
    np.testing.assert_allclose(frames[:, :, 0], normals, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-12)
    products = frames.transpose(0, 2, 1) @ frames
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), products.shape), atol=1e-12)


def test_angles_and_quaternions_are_those_of_the_rotation() -> None:
    for angle in (0.0, 1e-6, 0.7, 2.0, np.pi - 1e-3):
        axis = np.array([2.0, -1.0, 2.0]) / 3.0
        turn = pin.exp3(angle * axis)
        assert rotation_angle(turn) == pytest.approx(angle, abs=1e-7)
        position, quaternion = pose_to_wxyz(SE3(turn, np.array([0.1, 0.2, 0.3])))
        expected = [np.cos(angle / 2), *(np.sin(angle / 2) * axis)]
        np.testing.assert_allclose(np.asarray(quaternion) * np.sign(quaternion[0]), expected)
        np.testing.assert_allclose(pose_from_wxyz(position, quaternion).rotation, turn, atol=1e-12)
