"""STL files: separate triangles in float32."""

import io

import numpy as np
import trimesh


def stl_bytes(mesh):
    """The bytes of a binary STL file of a mesh."""
    facets = np.zeros(
        len(mesh.faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("", "<u2")]
    )
    facets["corners"] = mesh.vertices[mesh.faces]
    return bytes(80) + np.uint32(len(facets)).tobytes() + facets.tobytes()


def from_stl(mesh, *, merge=False):
    """A mesh written to an STL file and read again, by default with no vertex shared."""
    return trimesh.load_mesh(io.BytesIO(stl_bytes(mesh)), file_type="stl", process=merge)
