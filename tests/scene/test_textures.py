"""Textures: texels over footprints, for cameras and photons."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image

import photonrelax as pr
from photonrelax.scene.digest import scene_digest
from photonrelax.scene.textures import decoded_image

RNG = np.random.default_rng(3)
NOISE = RNG.uniform(0.0, 1.0, (23, 31, 3))
DOWN = pr.CollimatedEmitter((0, 0, -1), np.pi)


def texels(texture, u, v):
    """Numbers of the texels at texture coordinates, by the definition of texels and wrapping."""
    height, width = np.shape(texture.image)[:2]
    index = []
    for at, n, mode in zip((u, 1.0 - v), (width, height), texture.wrap, strict=True):
        texel = np.floor(at * n).astype(int)
        if mode == "clamp":
            texel = texel.clip(0, n - 1)
        elif mode == "repeat":
            texel = texel % n
        else:
            texel = texel % (2 * n)
            texel = np.where(texel < n, texel, 2 * n - 1 - texel)
        index.append(texel)
    return index[1] * width + index[0]


def of_texels(texture):
    return np.asarray(texture.image, dtype=float).reshape(-1, 3) * texture.factor


def colours(texture, u, v):
    return of_texels(texture)[texels(texture, u, v)]


def brute_mean(texture, uv, edges, n=1500):
    along, across = np.meshgrid(*[(np.arange(n) + 0.5) / n - 0.5] * 2)
    at = uv + along[..., None] * edges[0] + across[..., None] * edges[1]
    number = texels(texture, at[..., 0].ravel(), at[..., 1].ravel())
    every = of_texels(texture)
    return np.bincount(number, minlength=len(every)) @ every / n**2


@pytest.mark.parametrize("wrap", ["repeat", "mirror", "clamp", ("clamp", "mirror")])
def test_means_are_of_texels_by_their_area(wrap):
    texture = pr.Texture(NOISE, wrap=wrap, factor=(1.0, 0.5, 0.25))
    for size in (0.01, 0.1, 0.4, 3.0):
        uv, edges = RNG.uniform(-1, 2, 2), size * RNG.normal(size=(2, 2))
        mean = texture.means(uv[None], edges[None])[0]
        np.testing.assert_allclose(mean, brute_mean(texture, uv, edges), atol=2e-3)


def test_a_footprint_of_whole_texels_is_their_exact_mean():
    texture = pr.Texture(NOISE)
    edges = np.array([[[4 / 31, 0.0], [0.0, 3 / 23]]])
    mean = texture.means(np.array([[12 / 31, 1.0 - 8.5 / 23]]), edges)
    np.testing.assert_allclose(mean[0], NOISE[7:10, 10:14].mean(axis=(0, 1)), rtol=1e-6)


def test_footprints_without_an_area_are_points():
    texture = pr.Texture(NOISE)
    uv = RNG.uniform(-2, 2, (50, 2))
    for edges in (np.zeros((50, 2, 2)), np.tile([[0.1, 0.2], [0.2, 0.4]], (50, 1, 1))):
        expected = colours(texture, uv[:, 0], uv[:, 1])
        np.testing.assert_allclose(texture.means(uv, edges), expected, rtol=1e-6)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("shape", [(1024, 1024), (900, 1201)])
def test_large_footprints_are_means_of_blocks(shape):
    """Within 0.1 % of the mean of all texels, of noise of the contrast of texels."""
    image = np.random.default_rng(5).uniform(0.2, 1.0, (*shape, 3)).astype(np.float32)
    image[: shape[0] // 3] *= 0.5
    texture = pr.Texture(image)
    for size in (0.5, 0.7):
        uv, edges = np.array([0.4, 0.6]), size * np.array([[0.6, 0.2], [-0.1, 0.5]])
        mean = texture.means(uv[None], edges[None])[0]
        np.testing.assert_allclose(mean, brute_mean(texture, uv, edges, 2500), rtol=1e-3)
    many = texture.means(uv[None], 977.0 * np.eye(2)[None])[0]
    np.testing.assert_allclose(many, texture.mean, rtol=1e-3)


def test_the_mean_of_the_image():
    texture = pr.Texture(NOISE, factor=0.5)
    np.testing.assert_allclose(texture.mean, 0.5 * NOISE.mean(axis=(0, 1)), rtol=1e-6)


def test_bytes_are_srgb_in_files_and_linear_in_arrays(tmp_path):
    values = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    Image.fromarray(values).save(tmp_path / "a.png")
    stored = np.arange(256) / 255.0
    linear = np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(pr.Texture(tmp_path / "a.png").mean, linear.mean(), rtol=1e-6)
    np.testing.assert_allclose(pr.Texture(values).mean, 0.5, rtol=1e-6)
    (tmp_path / "b.png").write_bytes(b"no image")
    with pytest.raises(ValueError, match="cannot be read as an image"):
        pr.Texture(tmp_path / "b.png")
    with pytest.raises(FileNotFoundError):
        decoded_image(tmp_path / "c.png")


@pytest.mark.parametrize(
    ("image", "options", "message"),
    [
        (np.zeros((3, 3)), {}, "should have shape"),
        (np.full((3, 3, 3), 2.0), {}, r"should lie in \[0, 1\], but is from 0 to 2"),
        (np.full((3, 3, 3), np.nan), {}, "should be finite"),
        (NOISE, {"wrap": "fold"}, "wrap should be one of repeat"),
        (NOISE, {"wrap": ("clamp",)}, "one mode or two"),
        (NOISE, {"encoding": "log"}, "encoding should be one of"),
        (NOISE, {"factor": 2.0}, "factor should lie in"),
        (NOISE, {"uv": np.zeros((3, 3))}, "uv should have shape"),
    ],
)
def test_what_is_no_texture_is_refused(image, options, message):
    with pytest.raises((ValueError, TypeError), match=message):
        pr.Texture(image, **options)


def floor(texture, half=4.0, uv=((0, 0), (1, 0), (1, 1), (0, 1))):
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    return pr.SceneObject(mesh, pr.Diffuse(replace(texture, uv=uv)), "floor")


def pixels_of(texture, camera, repeats=1.0, supersampling=2):
    uv = repeats * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    scene = pr.Scene([floor(texture, uv=uv)], [DOWN], camera)
    image = pr.render(scene, components=("direct",), supersampling=supersampling)
    return image.layers["radiance"]


def orthographic(height, pixels=8):
    return pr.Camera(
        (0.3, 0.2, 5.0), (0.3, 0.2, 0), (0, 1, 0), width=pixels, height=pixels,
        orthographic_height=height,
    )  # fmt: skip


@pytest.mark.parametrize(("height", "repeats"), [(0.02, 1), (0.5, 1), (6.0, 1), (6.0, 40)])
def test_a_textured_floor_shows_the_mean_over_each_pixel(height, repeats):
    """Near, and so far that a pixel covers thousands of texels."""
    texture = pr.Texture(np.random.default_rng(8).uniform(0.3, 1.0, (500, 300, 3)))
    found = pixels_of(texture, orthographic(height), repeats)
    for row, column in ((0, 0), (3, 6), (7, 2))[: 1 if repeats > 1 else 3]:
        side = height / 8
        middle = np.array([0.3, 0.2]) + side * np.array([column - 3.5, 3.5 - row])
        uv = repeats * (middle + 4.0) / 8.0
        edges = repeats * side / 8.0 * np.eye(2)
        n = 1500 if repeats == 1 else 2500
        expected = brute_mean(texture, uv, edges, n)
        np.testing.assert_allclose(found[row, column], expected, rtol=1e-3)


def test_a_slanted_floor_has_no_moire():
    """Fine stripes, of which every pixel has many: all of the floor is grey."""
    stripes = np.zeros((64, 64, 3))
    stripes[:, ::2] = 1.0
    camera = pr.Camera((0, -6, 1.0), (0, 0, 0), (0, 0, 1), 10.0, 32, 8)
    found = pixels_of(pr.Texture(stripes), camera, repeats=97.0)
    np.testing.assert_allclose(found[3:], 0.5, rtol=2e-2)


def test_mirrors_and_smooth_meshes_show_textures():
    """A ball whose upper half is white, seen from above and in a mirror below."""
    ball = trimesh.creation.icosphere(3)
    uv = np.column_stack([0.0 * ball.vertices[:, 2], 0.5 + ball.vertices[:, 2] / 2.0])
    halves = np.ones((2, 1, 3)) * [[[0.9]], [[0.1]]]
    item = pr.SceneObject(ball, pr.Diffuse(pr.Texture(halves, uv=uv, wrap="clamp")), smooth=True)
    mirror = trimesh.creation.box((20, 20, 0.1))
    mirror.apply_translation((0, 0, -3))
    scene = pr.Scene([item, pr.SceneObject(mirror, pr.Mirror())], [DOWN])
    for origin, target, expected in (((0, 0, 9), (0, 0, 0), 0.9), ((4, 0, 1), (0, 0, -4.9), 0.1)):
        camera = pr.Camera(origin, target, (0, 1, 0), 1.0, 4, 4)
        image = pr.render(replace(scene, camera=camera), components=("direct",))
        np.testing.assert_allclose(image.layers["albedo"], expected, rtol=1e-6)


def test_photons_scatter_by_the_texel_that_they_meet():
    """Of light on a floor that is half black, photons on the ceiling come from the other half."""
    halves = np.ones((1, 2, 3)) * [[[0.0], [0.8]]]
    ceiling = trimesh.creation.box((40, 40, 0.1))
    ceiling.apply_translation((0, 0, 1.0))
    light = pr.SpotEmitter((0, 0, 0.9), (0, 0, -1), outer_angle=60.0)
    scene = pr.Scene([floor(pr.Texture(halves)), pr.SceneObject(ceiling, pr.Diffuse(0.0))], [light])
    photons = pr.trace_photons(scene, 40_000, paths="global")
    assert photons.flux[:, 0].sum() == pytest.approx(0.4, rel=0.02)
    assert photons.position[:, 0].mean() > 0.2


def test_texture_coordinates_come_with_the_mesh_or_are_asked_for():
    square = floor(pr.Texture(NOISE)).mesh
    with pytest.raises(ValueError, match="there are none: give the Texture uv"):
        pr.SceneObject(square, pr.Diffuse(pr.Texture(NOISE)))
    with pytest.raises(ValueError, match=r"should have shape \(4, 2\), a row a vertex, but have"):
        pr.SceneObject(square, pr.Diffuse(pr.Texture(NOISE, uv=np.zeros((7, 2)))))
    square.visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    mine = pr.SceneObject(square, pr.Diffuse(pr.Texture(NOISE)))
    assert mine.material.texture is mine.material.albedo


def test_digests_tell_textures_apart():
    def digest(texture):
        return scene_digest(pr.Scene([floor(texture)], [DOWN]))

    one = digest(pr.Texture(NOISE))
    assert one == digest(pr.Texture(NOISE.copy()))
    others = [{"wrap": "clamp"}, {"factor": 0.5}, {"wrap": "mirror"}]
    assert len({one, *(digest(pr.Texture(NOISE, **each)) for each in others)}) == 4
    assert digest(pr.Texture(NOISE[::-1])) != one


@pytest.mark.kernels_run_elsewhere
def test_a_large_texture_costs_no_more_than_its_own_bytes():
    image = np.random.default_rng(1).integers(0, 256, (4096, 4096, 3), dtype=np.uint8)
    image.setflags(write=False)
    tracemalloc.start()
    texture = pr.Texture(image)
    above = replace(orthographic(8.0, pixels=16), origin=(0, 0, 5), target=(0, 0, 0))
    found = pixels_of(texture, above, supersampling=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.2 * image.nbytes
    expected = image.reshape(16, 256, 16, 256, 3).mean(axis=(1, 3)) / 255.0
    np.testing.assert_allclose(found, expected, rtol=1e-5)
