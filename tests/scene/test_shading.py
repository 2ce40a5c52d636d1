"""Normals of smooth objects: welded by position, sharp at creases, given ones kept."""

import io

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.scene.digest import scene_digests
from photonrelax.transport.raycast import RayCaster
from tests.analytic.lens import PlanoConvex
from tests.helpers.stl import from_stl
from tests.helpers.tracing_scenes import DOWN, ball, box, floor, sheet

MATERIALS = [pr.Dielectric(1.5), pr.Mirror()]


def corner_normals(mesh, smooth=True):
    """Normals (f, 3, 3) at the corners of the faces."""
    shading = pr.SceneObject(mesh, pr.Mirror(), smooth=smooth).shading_normals
    np.testing.assert_array_equal(shading.vertex[shading.faces], mesh.faces)
    return shading.normal[shading.faces]


def face_normals(mesh):
    return np.repeat(np.asarray(mesh.face_normals)[:, None], 3, axis=1)


def split_uv_sphere(n=24):
    """A sphere of rows and columns whose seam and poles are vertices that rounding moves apart."""
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n), indexing="ij"
    )
    points = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    corner = np.arange(2 * n * n).reshape(n, 2 * n)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    faces = np.concatenate([np.stack(q, -1).reshape(-1, 3) for q in ((a, b, c), (a, c, d))])
    return trimesh.Trimesh(np.stack(points, -1).reshape(-1, 3), faces, process=False)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(
    "make", [lambda: ball(1.0, [0, 0, 0]), lambda: from_stl(ball(1.0, [0, 0, 0])), split_uv_sphere]
)
def test_normals_of_a_sphere_are_radial_wherever_its_vertices_are_split(make, scale):
    mesh = make()
    mesh.apply_scale(scale)
    extended = mesh.area_faces > 1e-9 * scale**2
    radial = mesh.vertices[mesh.faces] / scale
    np.testing.assert_allclose(corner_normals(mesh)[extended], radial[extended], atol=3e-6)


def test_normals_of_half_a_sphere_are_radial_up_to_its_border():
    """At a border all faces lie on one side: a mean over them would lean by 0.05."""
    mesh = ball(1.0, [0, 0, 0])
    mesh.update_faces(mesh.triangles_center[:, 2] > 0)
    np.testing.assert_allclose(corner_normals(mesh), mesh.vertices[mesh.faces], atol=6e-3)


@pytest.mark.parametrize("soup", [False, True])
@pytest.mark.parametrize("sections", [12, 13, 64])
def test_a_cylinder_is_flat_on_end_and_round_at_the_side(sections, soup):
    mesh = trimesh.creation.cylinder(1.0, 3.0, sections=sections)
    mesh = from_stl(mesh) if soup else mesh
    normals, corners = corner_normals(mesh), mesh.vertices[mesh.faces]
    end = np.abs(mesh.face_normals[:, 2]) > 0.5
    np.testing.assert_allclose(normals[end], face_normals(mesh)[end], atol=1e-6)
    radial = corners[~end] * [1, 1, 0]
    np.testing.assert_allclose(normals[~end], radial, atol=1e-5)


@pytest.mark.parametrize("soup", [False, True])
@pytest.mark.parametrize("smooth", [True, 30.0, 89])
def test_a_box_has_its_faces_own_normals(smooth, soup):
    mesh = from_stl(box([2, 2, 1])) if soup else box([2, 2, 1])
    np.testing.assert_allclose(corner_normals(mesh, smooth), face_normals(mesh), atol=1e-6)


def test_a_crease_angle_decides_which_edges_are_sharp():
    """The edges of an icosahedron turn by 41.8°."""
    mesh = trimesh.creation.icosahedron()
    radial = mesh.vertices[mesh.faces] / np.linalg.norm(mesh.vertices[0])
    for sharp in (True, 0, 30, 41.7):
        np.testing.assert_allclose(corner_normals(mesh, sharp), face_normals(mesh), atol=1e-12)
    for rounded in (41.9, 90, 180.0):
        np.testing.assert_allclose(corner_normals(mesh, rounded), radial, atol=1e-12)


def test_a_small_part_of_a_wide_mesh_keeps_its_shape():
    wide = trimesh.util.concatenate([box([2e5, 2e5, 1]), ball(0.1, [0, 0, 5])])
    small = slice(12, None)
    radial = (wide.vertices[wide.faces] - [0, 0, 5]) / 0.1
    np.testing.assert_allclose(corner_normals(wide)[small], radial[small], atol=1e-4)


def test_faces_that_wind_against_each_other_share_no_normal():
    mesh = ball(1.0, [0, 0, 0])
    turned = np.arange(len(mesh.faces)) % 10 == 0
    faces = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
    mesh = trimesh.Trimesh(mesh.vertices, faces, process=False)
    cosine = (corner_normals(mesh) * face_normals(mesh)).sum(axis=2)
    assert cosine.min() > np.cos(np.radians(15))


def from_beside(points):
    """Directions of points as seen from (-0.3, 0, 0)."""
    points = np.add(points, [0.3, 0, 0])
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


def in_file(file_type, mesh, **options):
    """A mesh with normals `from_beside`, as the bytes of a file."""
    normals = from_beside(mesh.vertices)
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals, process=False)
    data = mesh.export(file_type=file_type, **options)
    return io.BytesIO(data.encode() if isinstance(data, str) else data)


@pytest.mark.parametrize(
    ("file_type", "options"), [("ply", {}), ("glb", {}), ("obj", {"include_normals": True})]
)
def test_normals_of_files_are_kept_but_for_a_crease_angle(file_type, options):
    file = in_file(file_type, ball(1.0, [0, 0, 0]), **options)
    (read,) = trimesh.load_scene(file, file_type=file_type).geometry.values()
    corners = read.vertices[read.faces]
    np.testing.assert_allclose(corner_normals(read), from_beside(corners), atol=1e-6)
    np.testing.assert_allclose(corner_normals(read, 30), corners, atol=1e-5)


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_normals_of_ply_files_are_kept_where_trimesh_drops_them(encoding, split):
    mesh = ball(1.0, [0, 0, 0])
    file = in_file("ply", from_stl(mesh) if split else mesh, encoding=encoding)
    read = trimesh.load_mesh(file, file_type="ply")
    expected = from_beside(read.vertices[read.faces])
    np.testing.assert_allclose(corner_normals(read), expected, atol=1e-6)
    stretched = read.copy().apply_scale([1, 1, 2]).apply_translation([5, 0, 0])
    expected *= [1, 1, 0.5]
    expected /= np.linalg.norm(expected, axis=2, keepdims=True)
    np.testing.assert_allclose(corner_normals(stretched), expected, atol=1e-5)
    # Of a mesh that was edited they are means as of any other.
    read.update_faces(np.arange(len(read.faces)) > 0)
    np.testing.assert_allclose(corner_normals(read), read.vertices[read.faces], atol=1e-3)


def test_ply_files_without_normals_are_like_others():
    data = io.BytesIO(ball(1.0, [0, 0, 0]).export(file_type="ply", vertex_normal=False))
    read = trimesh.load_mesh(data, file_type="ply")
    np.testing.assert_allclose(corner_normals(read), read.vertices[read.faces], atol=1e-5)


@pytest.mark.parametrize("smooth", [-1, 181, np.nan])
def test_crease_angles_lie_between_0_and_180(smooth):
    with pytest.raises(ValueError, match="smooth"):
        pr.SceneObject(box([1, 1, 1]), pr.Mirror(), smooth=smooth)


def test_smooth_is_no_text():
    with pytest.raises(TypeError, match="smooth"):
        pr.SceneObject(box([1, 1, 1]), pr.Mirror(), smooth="30")


def test_digests_depend_on_the_crease_angle_not_on_its_type():
    def digest(smooth):
        item = pr.SceneObject(ball(1.0, [0, 0, 0]), pr.Mirror(), smooth=smooth)
        return scene_digests(pr.Scene([item], [DOWN]))["digest of the objects"]

    assert digest(30) == digest(30.0) == digest(np.float32(30.0))
    assert digest(True) == digest(np.True_)
    assert len({digest(False), digest(True), digest(30), digest(5.0)}) == 4


FLAT_ON_END = [box([2, 2, 1]), from_stl(trimesh.creation.cylinder(1.5, 1))]


@pytest.mark.parametrize("mesh", FLAT_ON_END)
def test_light_straight_on_flat_ends_of_glass_stays_straight(mesh):
    item = pr.SceneObject(mesh, pr.Dielectric(1.5), smooth=True)
    screen = pr.SceneObject(sheet(20.0, -4.0), pr.Diffuse(0.5))
    photons = pr.trace_photons(pr.Scene([item, screen], [DOWN]), 100_000)
    near = (np.abs(photons.position[:, :2]) < 0.5).all(axis=1) & (photons.n_bounces == 2)
    assert photons.flux[near, 0].sum() == pytest.approx(0.96**2, rel=0.03)


@pytest.mark.parametrize("mesh", FLAT_ON_END)
def test_a_flat_end_of_a_mirror_throws_the_image_of_a_lamp(mesh):
    """The top at 0.5 makes a lamp at 3 seem to be at -2: the solid angle of a square above it."""
    item = pr.SceneObject(mesh, pr.Mirror(), smooth=True)
    ceiling = pr.SceneObject(sheet(20.0, 4.0), pr.Diffuse(0.5))
    lamp = pr.PointEmitter([0, 0, 3.0], 4 * np.pi)
    photons = pr.trace_photons(pr.Scene([item, ceiling], [lamp]), 100_000)
    near = (np.abs(photons.position[:, :2]) < 0.5).all(axis=1) & (photons.n_bounces == 1)
    edge = 0.5 / (4.0 + 2.0)
    solid_angle = 4 * np.arcsin(edge**2 / (1 + edge**2))
    assert photons.flux[near, 0].sum() == pytest.approx(solid_angle, rel=0.05)


def test_a_panel_with_a_frame_is_flat_for_photons():
    """A pane of glass in one mesh with the bars around it, from an STL file."""
    bars = [box([2.4, 0.2, 0.4], [0, y, 1]) for y in (-1.1, 1.1)]
    panel = from_stl(trimesh.util.concatenate([box([2.0, 2.0, 0.1], [0, 0, 1]), *bars]))
    item = pr.SceneObject(panel, pr.Dielectric(1.5), smooth=True)
    photons = pr.trace_photons(pr.Scene([item, floor()], [DOWN]), 50_000)
    inside = (np.abs(photons.position[:, :2]) < 0.9).all(axis=1) & (photons.n_bounces == 2)
    assert photons.flux[inside, 0].sum() == pytest.approx(1.8**2 * 0.96**2, rel=0.03)


def test_a_soup_focuses_light_as_the_merged_mesh_does():
    def flux_on_axis(mesh):
        item = pr.SceneObject(mesh, pr.Dielectric(1.5), smooth=True)
        photons = pr.trace_photons(pr.Scene([item, floor()], [DOWN]), 50_000, max_bounces=2)
        distance = np.linalg.norm(photons.position[:, :2], axis=1)
        return [photons.flux[distance < r, 0].sum() for r in (0.05, 0.1, 0.2)]

    mesh = ball(0.5, [0, 0, 0.75], 4)
    np.testing.assert_allclose(flux_on_axis(from_stl(mesh)), flux_on_axis(mesh), rtol=0.01)


@pytest.mark.parametrize("material", MATERIALS)
def test_a_camera_sees_a_soup_as_the_merged_mesh(material):
    def normals_seen(mesh):
        camera = pr.Camera([0, -4, 2], [0, 0, 0.7], width=24, height=24, vertical_fov=25)
        scene = pr.Scene([pr.SceneObject(mesh, material, smooth=True), floor()], [DOWN], camera)
        return pr.render(scene, n_emitted=2000, n_global=0).layers["N"]

    mesh = ball(0.5, [0, 0, 0.7])
    np.testing.assert_allclose(normals_seen(from_stl(mesh)), normals_seen(mesh), atol=1e-4)


def test_a_camera_sees_the_sharp_edges_of_a_mirror():
    """The normals seen of a cylinder on end: up, or level, none between."""
    mesh = from_stl(trimesh.creation.cylinder(0.5, 1.0, sections=48))
    item = pr.SceneObject(mesh, pr.Mirror(), smooth=True)
    rng = np.random.default_rng(1)
    hits = RayCaster([item]).intersect(np.full((5000, 3), 3.0), rng.uniform(-3.4, -2.6, (5000, 3)))
    upward = hits.shading_normal[hits.hit][:, 2]
    assert len(upward) > 500
    assert np.minimum(np.abs(upward), np.abs(upward - 1)).max() < 1e-6


LENS = PlanoConvex()


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("merge", [False, True])
@pytest.mark.parametrize("closer", [0.0, 1.0, 3.0])
def test_a_lens_of_an_stl_file_focuses_like_exact_rays(closer, merge):
    """At the focus of rays near the axis, and where those from further out meet."""
    depth = LENS.focus - closer
    screen = box([120, 120, 1], [0, 0, -depth - 0.5])
    lens = pr.SceneObject(from_stl(LENS.mesh(), merge=merge), pr.Dielectric(LENS.ior), smooth=True)
    scene = pr.Scene([lens, pr.SceneObject(screen, pr.Diffuse(0.5))], [DOWN])
    photons = pr.trace_photons(scene, 100_000)
    distance = np.linalg.norm(photons.position[:, :2], axis=1)
    for radius in (0.05, 1.0):
        through = (photons.n_bounces == 2) & (distance < radius)
        expected = LENS.flux_within(radius, depth)
        assert photons.flux[through, 0].sum() == pytest.approx(expected, rel=0.02)
