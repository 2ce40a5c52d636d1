"""Small scenes to trace photons through."""

import numpy as np
import trimesh

import photonrelax as pr

DOWN = pr.CollimatedEmitter([0, 0, -1])


def box(extents, centre=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation(centre)
    return mesh


def sheet(size, z=0.0):
    corners = [[-size, -size, z], [size, -size, z], [size, size, z], [-size, size, z]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def cube_wall(axis, side):
    """A wall of the cube of side 2, seen from within."""
    corners = np.zeros((4, 3))
    corners[:, axis] = side
    corners[:, (axis + 1) % 3] = [-1, 1, 1, -1]
    corners[:, (axis + 2) % 3] = [-1, -1, 1, 1]
    faces = [[0, 1, 2], [0, 2, 3]] if side < 0 else [[0, 2, 1], [0, 3, 2]]
    return trimesh.Trimesh(corners, faces, process=False)


def coloured_walls(albedos):
    """The walls of a cube of side 2, by their albedos (6, 3)."""
    meshes = [cube_wall(axis, side) for axis in range(3) for side in (-1, 1)]
    walls = zip(meshes, albedos, strict=True)
    return [pr.SceneObject(mesh, pr.Diffuse(albedo)) for mesh, albedo in walls]


def ball(radius, centre, subdivisions=3):
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    mesh.apply_translation(centre)
    return mesh


def scene_of(*meshes):
    """A scene of diffuse meshes under light from above."""
    return pr.Scene([pr.SceneObject(mesh, pr.Diffuse()) for mesh in meshes], [DOWN])


def floor(size=4.0, albedo=0.8):
    return pr.SceneObject(sheet(size), pr.Diffuse(albedo))


def slab(absorption=0.0, ior=1.5):
    return pr.SceneObject(box([4, 4, 0.02], [0, 0, 1]), pr.Dielectric(ior, absorption=absorption))


def glass_ball(smooth=True, **glass):
    return pr.SceneObject(ball(0.5, [0, 0, 1]), pr.Dielectric(**glass), smooth=smooth)


def leaning(material, lean):
    """A flat sheet whose smooth normals lean towards +x by an angle."""
    flat = sheet(1.0, z=1.0)
    normals = [[np.sin(lean), 0.0, np.cos(lean)]] * 4
    mesh = trimesh.Trimesh(flat.vertices, flat.faces, vertex_normals=normals, process=False)
    return pr.SceneObject(mesh, material, smooth=True)


def mirror_ball(reflectance):
    # Coarse and smooth: interpolated normals often point away from the rays.
    return pr.SceneObject(ball(0.5, [1, 0, 1], 1), pr.Mirror(reflectance), smooth=True)


def enclosure(albedo):
    return pr.SceneObject(box([2, 2, 2]), pr.Diffuse(albedo))


INSIDE = pr.PointEmitter([0.1, 0.2, 0.3], (1.0, 2.0, 3.0))
LAMBERT = pr.LambertianEmitter([0, 1, 3], [0, -0.3, -1], (3.0, 2.0, 0.0))
TINT = (0.9, 0.5, 0.1)

SCENES = {
    "glass ball": pr.Scene([floor(), glass_ball()], [DOWN]),
    "tinted glass, mirror, three emitters": pr.Scene(
        [floor(albedo=TINT), glass_ball(absorption=(0.1, 1.0, 3.0)), mirror_ball(TINT)],
        [DOWN, pr.PointEmitter([0, 0, 3], (5.0, 1.0, 0.0)), LAMBERT],
    ),
    "emitter in glass": pr.Scene(
        [floor(), glass_ball(absorption=TINT)], [pr.PointEmitter([0.1, 0.1, 0.9])]
    ),
    "glass and mirror in an enclosure": pr.Scene(
        [
            enclosure(TINT),
            pr.SceneObject(ball(0.3, [0.4, 0.4, 0.4]), pr.Dielectric(absorption=1.0)),
            pr.SceneObject(ball(0.3, [-0.4, -0.4, -0.4]), pr.Mirror(TINT)),
        ],
        [pr.PointEmitter([0, 0, 0], (1.0, 2.0, 3.0))],
    ),
    "bubble and lamp in tinted water": pr.Scene(
        [
            floor(albedo=TINT),
            pr.SceneObject(box([3, 3, 2], [0, 0, 0.9]), pr.Dielectric(1.33, absorption=TINT)),
            glass_ball(ior=1.0),
            mirror_ball(TINT),
        ],
        [DOWN, pr.PointEmitter([-0.7, 0, 1], (1.0, 2.0, 3.0)), pr.PointEmitter([0, 0.1, 1])],
    ),
}
