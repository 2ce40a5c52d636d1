"""Boundaries of surfaces: edges, creases and contact lines of figures whose outlines are known."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

import photonrelax as pr
from photonrelax import gallery
from photonrelax.gallery.meshes import grid_faces, make_mesh
from photonrelax.surfaces.boundaries import Part, SurfaceBoundary
from tests.helpers.stl import from_stl
from tests.helpers.tracing_scenes import ball, box, sheet

UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])


def boundary(*meshes, **materials):
    """The boundary of diffuse meshes, and of those of materials: glass=mesh, mirror=mesh, …"""
    of = {"glass": pr.Dielectric, "mirror": pr.Mirror, "sensor": pr.Sensor}
    objects = [pr.SceneObject(mesh, pr.Diffuse()) for mesh in meshes]
    objects += [pr.SceneObject(mesh, of[name]()) for name, mesh in materials.items()]
    return SurfaceBoundary.of(objects)


def of_side(found, normal, z=None):
    """Ends of the segments that count for light on the side of a normal, at a height z if given."""
    cosine = found.normals @ normal
    ends = np.concatenate(
        [
            found.segments[cosine > 0.99],
            found.segments[(cosine < -0.99) & ~found.one_sided][:, ::-1],
        ]
    )
    return ends if z is None else ends[(np.abs(ends[..., 2] - z) < 1e-6).all(axis=1)]


def area(ends, normal):
    """Area to the left of closed polygons, none of whose ends may be loose."""
    start, end = np.round(ends.reshape(-1, 6), 6)[:, :3], np.round(ends.reshape(-1, 6), 6)[:, 3:]
    points, number = np.unique(np.concatenate([start, end]) + 0.0, axis=0, return_inverse=True)
    n = len(points)
    np.testing.assert_array_equal(
        np.bincount(number[: len(ends)], minlength=n), np.bincount(number[len(ends) :], minlength=n)
    )
    return 0.5 * np.sum(np.cross(ends[:, 0], ends[:, 1]) @ normal)


def lines(ends):
    """Segments as a set, rounded."""
    return {tuple(map(tuple, np.round(segment, 9) + 0.0)) for segment in ends}


def outline(low, high, z=0.0):
    """The sides of a rectangle, its inside to the left as seen from above."""
    (a, b), (c, d) = low, high
    corners = [(a, b, z), (c, b, z), (c, d, z), (a, d, z)]
    return {(corners[i - 1], corners[i]) for i in range(4)}


def hole(low, high, z=0.0):
    """The sides of a rectangle, its outside to the left."""
    return {(end, start) for start, end in outline(low, high, z)}


def moved(mesh, by):
    mesh = mesh.copy()
    mesh.apply_translation(by)
    return mesh


# Edges


@pytest.mark.parametrize("mesh", [sheet(1.0), from_stl(sheet(1.0)), sheet(1.0).subdivide()])
def test_a_sheet_ends_at_its_outline_on_both_sides(mesh):
    found = boundary(mesh)
    assert not found.one_sided.any()
    assert area(of_side(found, UP), UP) == pytest.approx(4.0)
    assert area(of_side(found, DOWN), DOWN) == pytest.approx(4.0)
    np.testing.assert_allclose(np.abs(found.segments[..., :2]).max(axis=2), 1.0)


def test_the_surface_is_to_the_left_of_a_segment():
    found = boundary(sheet(1.0))
    assert lines(found.segments) == outline((-1, -1), (1, 1))
    inward = np.cross(found.normals, found.segments[:, 1] - found.segments[:, 0])
    assert (np.einsum("nc,nc->n", inward, -found.segments.mean(axis=1)) > 0.0).all()
    assert found.segments.flags.c_contiguous


CUBE = box([1, 1, 1])


@pytest.mark.parametrize(
    "mesh", [CUBE, from_stl(CUBE), trimesh.Trimesh(CUBE.vertices, CUBE.faces[:, ::-1])]
)
def test_the_faces_of_a_box_end_at_its_edges_outside(mesh):
    found = boundary(mesh)
    assert len(found.segments) == 24
    assert found.one_sided.all()
    for normal in np.concatenate([np.eye(3), -np.eye(3)]):
        np.testing.assert_allclose(of_side(found, normal) @ normal, 0.5)
        assert area(of_side(found, normal), normal) == pytest.approx(1.0)


@pytest.mark.parametrize(("n", "n_edges"), [(5, 20 + 10), (6, 24), (24, 96)])
def test_a_surface_goes_on_where_it_turns_by_up_to_sixty_degrees(n, n_edges):
    assert len(boundary(trimesh.creation.cylinder(1.0, 2.0, sections=n)).segments) == n_edges


def test_a_sphere_has_no_boundary():
    found = boundary(ball(1.0, [0, 0, 0]))
    assert found.segments.shape == (0, 2, 3)
    assert found.normals.shape == (0, 3)
    assert found.one_sided.shape == (0,)


WINGS = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -1, 0], [0.5, 0, 1], [0.5, -1, 1e-3]])


@pytest.mark.parametrize(
    ("faces", "n_edges"),
    [
        ([[0, 1, 2], [1, 0, 3]], 4),
        # Wound against each other.
        ([[0, 1, 2], [0, 1, 3]], 4),
        ([[0, 1, 2], [1, 0, 4]], 6),
        ([[0, 1, 2], [0, 1, 4]], 6),
        # Folded over, one on the other.
        ([[1, 0, 3], [0, 1, 5]], 6),
        ([[1, 0, 3], [1, 0, 5]], 6),
        # Two that are one plane, and a wall on it.
        ([[0, 1, 2], [1, 0, 3], [0, 1, 4]], 7),
        ([[0, 1, 2], [0, 1, 3], [1, 0, 4]], 7),
    ],
)
def test_faces_of_an_edge_go_on_in_those_of_similar_normals_however_wound(faces, n_edges):
    found = boundary(trimesh.Trimesh(WINGS, faces, process=False))
    assert len(found.segments) == n_edges


# Other objects


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("flip", [1, -1])
def test_a_cube_covers_the_side_of_a_floor_that_it_stands_on(scale, flip):
    floor = trimesh.Trimesh(sheet(2.0).vertices, sheet(2.0).faces[:, ::flip], process=False)
    found = boundary(*(m.apply_scale(scale) for m in (floor, box([1, 1, 1], [0.6, -0.6, 0.5]))))
    above, below = (of_side(found, n, 0.0) / scale for n in (UP, DOWN))
    assert lines(above) == outline((-2, -2), (2, 2)) | hole((0.1, -1.1), (1.1, -0.1))
    # The base is below the floor for nobody.
    assert lines(below[:, ::-1]) == outline((-2, -2), (2, 2))
    assert len(found.segments) == 4 + 4 + 20


def test_gaps_that_rays_do_not_resolve_do_not_matter():
    for gap in (-1e-6, 1e-12, 1e-6):
        found = boundary(sheet(2.0), box([1, 1, 1], [0.6, -0.6, 0.5 + gap]))
        assert area(of_side(found, UP, 0.0), UP) == pytest.approx(15.0, abs=1e-4)
    found = boundary(sheet(2.0), box([1, 1, 1], [0.6, -0.6, 0.51]))
    assert area(of_side(found, UP, 0.0), UP) == pytest.approx(16.0)


@pytest.mark.parametrize("n", [2, 11])
@pytest.mark.parametrize("height", [0.2, 0.1, 0.0])
def test_contact_lines_may_run_along_edges_of_the_floor(n, height):
    x, y = np.meshgrid(*[np.linspace(-1, 1, n)] * 2)
    floor = make_mesh(np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]), grid_faces(n, n))
    found = boundary(floor, box([0.4, 0.4, 0.4], [0.0, 0.2, height]))
    assert area(of_side(found, UP, 0.0), UP) == pytest.approx(4.0 - 0.16)
    cut = height < 0.2
    assert area(of_side(found, DOWN, 0.0), DOWN) == pytest.approx(4.0 - 0.16 * cut)


def section_area(mesh, offset=0.0):
    """Area of a mesh cut at z = 0."""
    ends = trimesh.intersections.mesh_plane(mesh, UP, [0, 0, offset])
    corners = np.unique(np.round(ends[..., :2].reshape(-1, 2), 9), axis=0)
    return ConvexHull(corners).volume


@pytest.mark.parametrize("material", ["mirror", None])
def test_a_sunk_ball_cuts_a_polygon_out_of_both_sides(material):
    mesh = ball(1.0, [0.1, 0.05, 0.3])
    found = boundary(sheet(2.0), **{material: mesh}) if material else boundary(sheet(2.0), mesh)
    for normal in (UP, DOWN):
        remaining = area(of_side(found, normal, 0.0), normal)
        assert remaining == pytest.approx(16.0 - section_area(mesh), rel=1e-9)
    assert not found.one_sided.any()


def test_a_ball_sunk_to_a_row_of_its_edges_cuts_once():
    mesh = trimesh.creation.uv_sphere(1.0, count=(33, 33))
    found = boundary(sheet(2.0), mirror=mesh)
    for normal in (UP, DOWN):
        remaining = area(of_side(found, normal, 0.0), normal)
        assert remaining == pytest.approx(16.0 - section_area(mesh, 1e-12), rel=1e-6)


@settings(deadline=None, max_examples=60)
@given(
    turn=st.integers(0, 2**20),
    place=st.tuples(*[st.floats(-0.5, 0.5)] * 3),
    n=st.sampled_from([2, 5]),
)
def test_turned_boxes_cut_their_sections_out_of_a_floor(turn, place, n):
    mesh = box([1.0, 0.7, 0.5])
    mesh.apply_transform(
        trimesh.transformations.random_rotation_matrix(np.random.default_rng(turn).random(3))
    )
    mesh = moved(mesh, place)
    heights = mesh.vertices[:, 2]
    if np.abs(heights).min() < 1e-2 or heights.max() < 0.0 or heights.min() > 0.0:
        return
    x, y = np.meshgrid(*[np.linspace(-2, 2, n)] * 2)
    floor = make_mesh(np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]), grid_faces(n, n))
    found = boundary(floor, mirror=mesh)
    for normal in (UP, DOWN):
        remaining = 0.5 * np.sum(np.cross(*np.moveaxis(of_side(found, normal, 0.0), 1, 0)) @ normal)
        assert remaining == pytest.approx(16.0 - section_area(mesh), abs=1e-3)


def test_what_is_below_a_cube_at_the_edge_of_a_floor_has_no_edge():
    found = boundary(sheet(2.0), box([1, 1, 1], [2.0, -1.0, 0.5]))
    assert area(of_side(found, UP, 0.0), UP) == pytest.approx(15.5)
    # Seen from below the floor goes on in the base.
    assert area(of_side(found, DOWN, 0.0), DOWN) == pytest.approx(16.5)


def test_a_cube_flush_with_the_corner_of_a_slab_leaves_the_rest():
    found = boundary(box([4, 4, 1], [0, 0, -0.5]), box([1, 1, 1], [1.5, 1.5, 0.5]))
    assert area(of_side(found, UP, 0.0), UP) == pytest.approx(15.0)
    assert len(of_side(found, DOWN, 0.0)) == 0
    # Their sides are one.
    flush = of_side(found, np.array([1.0, 0.0, 0.0]))
    assert area(flush, np.array([1.0, 0.0, 0.0])) == pytest.approx(5.0)


def test_surfaces_that_abut_in_one_plane_are_one():
    left, right = moved(sheet(1.0), [-1, 0, 0]), moved(sheet(1.0), [1, 0.5, 0])
    for found in (boundary(left, right), boundary(right, left)):
        for normal in (UP, DOWN):
            assert area(of_side(found, normal), normal) == pytest.approx(8.0)


def test_a_cube_covers_the_tile_that_it_stands_on():
    tiles = [moved(sheet(0.5), [x, y, 0]) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    found = boundary(*tiles, box([1, 1, 1], [0, 0, 0.5]))
    assert area(of_side(found, UP, 0.0), UP) == pytest.approx(8.0)
    assert area(of_side(found, DOWN, 0.0), DOWN) == pytest.approx(9.0)


def test_a_poster_on_a_wall_makes_no_room_of_it():
    wall = box([4, 4, 0.1], [0, 0, -0.05])
    found = boundary(wall, sheet(1.0))
    assert area(of_side(found, UP, 0.0), UP) == pytest.approx(16.0)
    assert len(of_side(found, DOWN, 0.0)) == 0


def test_a_rug_in_the_plane_of_a_room_is_in_the_room():
    room, cube = box([4, 4, 4], [0, 0, 2]), box([1, 1, 1], [1.2, -0.8, 0.5])
    found = boundary(room, cube, moved(sheet(0.4), [-1, 1, 0]))
    assert area(of_side(found, UP, 0.0), UP) == pytest.approx(15.0)


def test_surfaces_that_overlap_in_one_plane_are_one():
    rug = moved(sheet(0.5), [1.5, 0.2, 0])
    for found in (boundary(sheet(2.0), rug), boundary(rug, sheet(2.0))):
        assert area(of_side(found, UP), UP) == pytest.approx(16.0)
    inlay = box([1, 1, 0.5], [0, 0, -0.25])
    found = boundary(box([4, 4, 1], [0, 0, -0.5]), inlay)
    assert area(of_side(found, UP, 0.0), UP) == pytest.approx(16.0)


@pytest.mark.parametrize("gap", [0.0, -0.1])
def test_cubes_beside_each_other_cover_the_floor_as_one(gap):
    cubes = box([1, 1, 1], [-0.5, 0, 0.5]), box([1, 1, 1], [0.5 + gap, 0.2, 0.5])
    found = boundary(sheet(2.0), *cubes)
    overlap = 0.8 * -gap
    assert area(of_side(found, UP, 0.0), UP) == pytest.approx(16.0 - 2.0 + overlap, abs=1e-3)
    assert area(of_side(found, UP, 1.0), UP) == pytest.approx(2.0 - overlap, abs=1e-3)


def test_glass_sensors_and_sheets_cover_nothing():
    alone = len(boundary(sheet(2.0)).segments)
    for name in ("glass", "sensor"):
        found = boundary(sheet(2.0), **{name: box([1, 1, 1], [0.1, 0.2, 0.3])})
        assert len(of_side(found, UP, 0.0)) == alone
    wall = sheet(1.0)
    wall.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    assert len(boundary(sheet(2.0), wall).segments) == 2 * alone


def test_mirrors_and_glass_have_no_boundary_of_their_own():
    assert len(boundary(mirror=CUBE, glass=ball(0.1, [2, 0, 0])).segments) == 0


def test_solids_cover_sensors_whose_both_sides_count():
    plane = sheet(2.0, z=0.2)
    found = boundary(box([1, 1, 1]), sensor=plane)
    for normal in (UP, DOWN):
        assert area(of_side(found, normal, 0.2), normal) == pytest.approx(15.0)
    shell = boundary(sensor=CUBE)
    assert len(shell.segments) == 24
    assert not shell.one_sided.any()


def test_sensors_on_a_floor_end_at_their_own_edges():
    found = boundary(sheet(2.0), sensor=sheet(1.0))
    assert lines(of_side(found, UP)) == outline((-2, -2), (2, 2)) | outline((-1, -1), (1, 1))


def test_a_closed_object_is_a_room_to_those_inside():
    room, cube = box([4, 4, 4], [0, 0, 2]), box([1, 1, 1], [0.2, -0.8, 0.5])
    for mesh in (room, trimesh.Trimesh(room.vertices, room.faces[:, ::-1])):
        found = boundary(mesh, cube)
        assert area(of_side(found, UP, 0.0), UP) == pytest.approx(15.0)
        assert area(of_side(found, UP, 1.0), UP) == pytest.approx(1.0)
        assert area(of_side(found, DOWN, 4.0), DOWN) == pytest.approx(16.0)


def test_hollow_bodies_cover_their_walls_alone():
    hollow = trimesh.util.concatenate(
        [box([2, 2, 2]), trimesh.Trimesh(CUBE.vertices, CUBE.faces[:, ::-1])]
    )
    found = boundary(sheet(3.0), mirror=hollow)
    assert area(of_side(found, UP, 0.0), UP) == pytest.approx(36.0 - 4.0 + 1.0)


@pytest.mark.parametrize("name", ["lights", "prism", "reflector", "ring", "ripples", "sphere"])
def test_floors_of_the_gallery_end_at_their_outline(name):
    sizes = {"subdivisions": 3} if name in ("lights", "prism", "sphere") else {}
    if name == "ripples":
        sizes = {"resolution": 40}
    objects = gallery.scene(name, **sizes).objects
    (floor,) = [item for item in objects if item.name == "floor"]
    found = SurfaceBoundary.of(objects)
    side = np.ptp(floor.mesh.vertices[:, 0])
    outer = area(of_side(found, UP, floor.mesh.vertices[0, 2]), UP)
    assert outer == pytest.approx(side**2, rel=0.05)


# Parts in dielectrics


def parts(*objects, dielectric):
    """Boundaries of what is in a dielectric, and of the rest."""
    one, none = frozenset([dielectric]), frozenset()
    return (SurfaceBoundary.of(objects, part=part) for part in (Part(one, none), Part(none, one)))


def test_a_dielectric_divides_a_floor_that_it_cuts():
    cut = pr.SceneObject(ball(1.0, [0.1, 0.05, 0.3]), pr.Dielectric())
    inside, outside = parts(pr.SceneObject(sheet(2.0), pr.Diffuse()), cut, dielectric=1)
    section = section_area(cut.mesh)
    for normal in (UP, DOWN):
        assert area(of_side(inside, normal, 0.0), normal) == pytest.approx(section)
        assert area(of_side(outside, normal, 0.0), normal) == pytest.approx(16.0 - section)


def test_a_dielectric_divides_edges_of_other_objects():
    """Water over half of a sheet, on which a cube stands in the waterline."""
    water = pr.SceneObject(box([8, 8, 4], [4.2, 0, 0]), pr.Dielectric())
    opaque = [
        pr.SceneObject(mesh, pr.Diffuse()) for mesh in (sheet(2.0), box([1, 1, 1], [0, 0, 0.5]))
    ]
    inside, outside = parts(water, *opaque, dielectric=0)
    assert area(of_side(inside, UP, 0.0), UP) == pytest.approx(1.8 * 4.0 - 0.3)
    assert area(of_side(outside, UP, 0.0), UP) == pytest.approx(2.2 * 4.0 - 0.7)
    assert area(of_side(inside, UP, 1.0), UP) == pytest.approx(0.3)
    assert area(of_side(outside, UP, 1.0), UP) == pytest.approx(0.7)


def test_what_is_wholly_in_a_dielectric_keeps_its_edges():
    water = pr.SceneObject(box([8, 8, 8]), pr.Dielectric())
    inside, _ = parts(water, pr.SceneObject(sheet(1.0), pr.Diffuse()), dielectric=0)
    assert area(of_side(inside, UP), UP) == pytest.approx(4.0)
