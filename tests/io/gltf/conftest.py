"""A character that every test of reading glTF may change."""

import numpy as np
import pytest

from .files import File, matrix, quaternion, worlds


@pytest.fixture
def character(rng):
    """A file with a skin of four joints below nodes with any transforms, bound in the pose at rest."""
    file = File()
    file.node(name="top", children=[1], translation=[3, 1, 2], rotation=quaternion(rng), scale=[2, 2, 2])
    file.node(name="hip", children=[2, 4], translation=[1, 0, 0], rotation=quaternion(rng))
    file.node(name="between", children=[3], rotation=quaternion(rng), scale=[1, 1.5, 1])
    file.node(name="arm", children=[5], translation=[0, 2, 0], rotation=quaternion(rng))
    file.node(name="leg", translation=[0, -2, 0], rotation=quaternion(rng))
    file.node(name="hand", translation=[0, 1, 0], rotation=quaternion(rng), scale=[0.5, 0.5, 0.5])
    file.joints = [1, 4, 3, 5]
    # Bound to a mesh that has a place of its own.
    place = matrix([0, 5, 0], quaternion(rng), [3, 3, 3])
    G = worlds(file.root)
    file.bind = np.array([np.linalg.inv(G[j]) @ place for j in file.joints])
    file.place = place
    matrices = file.accessor(np.swapaxes(file.bind, 1, 2))
    file.root["skins"] = [{"joints": file.joints, "inverseBindMatrices": matrices}]
    file.v = rng.normal(size=(12, 3)).astype("f4").astype(float)
    file.J = np.array([rng.permutation(4) for _ in range(12)])
    W = rng.random((12, 4))
    file.W = W / W.sum(axis=1, keepdims=True)
    attributes = {"POSITION": file.accessor(file.v), "JOINTS_0": file.accessor(file.J, "u1")}
    attributes["WEIGHTS_0"] = file.accessor(file.W)
    mesh = file.mesh(attributes, np.arange(12))
    # A skinned mesh does not move with its own node.
    file.node(name="body", mesh=mesh, skin=0, translation=[100, 0, 0])
    return file
