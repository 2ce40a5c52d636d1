"""Surfaces of glass: closed and wound outwards, or one warning; inside out is refused."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from tests.helpers.stl import from_stl
from tests.helpers.tracing_scenes import DOWN, ball, box, floor, sheet

GLASS = pr.Dielectric(1.5)


def with_faces(mesh, faces):
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def inverted(mesh):
    return with_faces(mesh, np.asarray(mesh.faces)[:, ::-1])


def joined(*meshes):
    return trimesh.util.concatenate(meshes)


def scene(mesh, material=GLASS):
    return pr.Scene([floor(), pr.SceneObject(mesh, material, "drop")], [DOWN])


def defects(mesh):
    return tuple(pr.SceneObject(mesh, GLASS).edge_defects)


BALL = ball(0.5, [0, 0, 1])


@pytest.mark.parametrize(
    "mesh",
    [
        BALL,
        from_stl(BALL),
        box([1, 2, 3]),
        trimesh.creation.torus(1.0, 0.3),
        trimesh.creation.annulus(0.5, 1.0, 1.0),
        joined(BALL, ball(0.5, [3, 0, 1])),
        # Boxes that share an edge have four faces there.
        joined(box([1, 1, 1]), box([1, 1, 1], [1, 1, 0])),
    ],
)
def test_closed_surfaces_are_accepted_in_silence(mesh):
    assert defects(mesh) == (0, 0)
    scene(mesh)


def test_open_edges_are_counted_and_the_object_is_named():
    hole = with_faces(BALL, BALL.faces[2:])
    n_open = 4 if len(np.intersect1d(*BALL.faces[:2])) == 2 else 6
    with pytest.warns(UserWarning, match=rf"objects\[1\] \('drop'\).* {n_open} open edges and 0"):
        scene(hole)


def test_turned_faces_are_counted():
    faces = np.array(BALL.faces)
    faces[7] = faces[7, ::-1]
    with pytest.warns(UserWarning, match=r" 0 open edges and 3 edges .*fix_winding"):
        scene(with_faces(BALL, faces))


def test_counts_of_a_soup_are_those_of_the_merged_mesh():
    faces = np.array(BALL.faces)[:-20]
    faces[::9] = faces[::9, ::-1]
    broken = with_faces(BALL, faces)
    assert defects(from_stl(broken)) == defects(broken)
    assert min(defects(broken)) > 10


@pytest.mark.parametrize("mesh", [sheet(1.0, 1.0), trimesh.creation.cylinder(1, 1)])
def test_there_is_one_warning_for_each_object_of_glass_and_none_for_others(mesh):
    mesh = with_faces(mesh, mesh.faces[:-1])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene(mesh, pr.Mirror())
        scene(mesh, pr.Diffuse())
        assert not caught
        broken = scene(mesh)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    with pytest.warns(UserWarning, match=r"objects\[0\]"):
        replace(broken, objects=broken.objects[::-1])


def test_the_remedies_of_the_warning_work():
    """The winding of most faces, or of few, may be the one that stays: an error then says so."""
    faces = np.array(BALL.faces)[:-1]
    faces[::9] = faces[::9, ::-1]
    mesh = from_stl(with_faces(BALL, faces))
    mesh.merge_vertices()
    trimesh.repair.fix_winding(mesh)
    mesh.fill_holes()
    with pytest.raises(ValueError, match=r"mesh\.invert"):
        pr.SceneObject(mesh, GLASS)
    mesh.invert()
    assert defects(mesh) == (0, 0)


@pytest.mark.parametrize("split", [False, True])
def test_a_hollow_bulb_winds_inwards_inside(split):
    """Walls of hollows, of several in a body, and of a ball in a hollow of a ball."""
    nested = [ball(r, [0, 0, 0]) for r in (1.0, 0.9, 0.5, 0.4)]
    bulb = joined(nested[0], inverted(nested[1]))
    bubbles = joined(box([2, 2, 2]), *(inverted(ball(0.3, [x, 0, 0])) for x in (-0.5, 0.5)))
    russian = joined(nested[0], inverted(nested[1]), nested[2], inverted(nested[3]))
    for mesh in (bulb, bubbles, russian):
        assert defects(from_stl(mesh) if split else mesh) == (0, 0)


@pytest.mark.parametrize("split", [False, True])
def test_parts_inside_out_are_refused_by_their_faces(split):
    mesh = joined(ball(1.0, [0, 0, 0]), inverted(ball(0.5, [3, 0, 0])))
    n = len(mesh.faces) // 2
    mesh = from_stl(mesh) if split else mesh
    message = rf"1 of its 2 connected parts, of {n} faces from face {n} on.*fix_inversion"
    with pytest.raises(ValueError, match=message):
        pr.SceneObject(mesh, GLASS)
    mesh.merge_vertices()
    trimesh.repair.fix_inversion(mesh, multibody=True)
    pr.SceneObject(mesh, GLASS)


def test_a_hollow_whose_two_walls_are_turned_is_refused():
    bulb = joined(inverted(ball(1.0, [0, 0, 0])), ball(0.9, [0, 0, 0]))
    with pytest.raises(ValueError, match="1 of its 2 connected parts"):
        pr.SceneObject(bulb, GLASS)
