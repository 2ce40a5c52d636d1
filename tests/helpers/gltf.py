"""glTF files made of a few arrays."""

import base64
import json

import numpy as np

SUN = {"type": "directional", "intensity": 683.0}
COMPONENTS = {"f": 5126, "u": 5125}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class GltfParts:
    """JSON of a file, with arrays added as accessors."""

    def __init__(self):
        self.bytes = bytearray()
        self.json = {
            "asset": {"version": "2.0", "generator": "tests"},
            "accessors": [],
            "bufferViews": [],
            "meshes": [],
            "nodes": [],
            "materials": [],
        }

    def accessor(self, array):
        array = np.asarray(array)
        array = array.astype("<f4" if array.dtype.kind == "f" else "<u4")
        width = array.shape[1] if array.ndim == 2 else 1
        view = {"buffer": 0, "byteOffset": len(self.bytes), "byteLength": array.nbytes}
        self.bytes += array.tobytes()
        self.json["bufferViews"].append(view)
        self.json["accessors"].append(
            {
                "bufferView": len(self.json["bufferViews"]) - 1,
                "componentType": COMPONENTS[array.dtype.kind],
                "count": len(array),
                "type": TYPES[width],
            }
        )
        return len(self.json["accessors"]) - 1

    def mesh(self, mesh, material=None, normals=None, uv=None):
        """Add a mesh with a material, JSON, and return its index."""
        attributes = {"POSITION": self.accessor(np.asarray(mesh.vertices, dtype=float))}
        if normals is not None:
            attributes["NORMAL"] = self.accessor(np.asarray(normals, dtype=float))
        if uv is not None:
            attributes["TEXCOORD_0"] = self.accessor(np.asarray(uv, dtype=float))
        indices = self.accessor(np.asarray(mesh.faces).ravel())
        primitive = {"attributes": attributes, "indices": indices}
        if material is not None:
            self.json["materials"].append(material)
            primitive["material"] = len(self.json["materials"]) - 1
        self.json["meshes"].append({"primitives": [primitive]})
        return len(self.json["meshes"]) - 1

    def node(self, **members):
        self.json["nodes"].append(members)
        return len(self.json["nodes"]) - 1

    def lights(self, *lights):
        """Add lights, each with a node that turns it down."""
        self.json.setdefault("extensions", {})["KHR_lights_punctual"] = {
            "lights": [dict(light) for light in lights]
        }
        for i in range(len(lights)):
            extensions = {"KHR_lights_punctual": {"light": i}}
            self.node(extensions=extensions, rotation=[-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])

    def finished(self):
        """The JSON with its buffer in it, and all nodes that are no children in one scene."""
        children = {child for node in self.json["nodes"] for child in node.get("children", [])}
        roots = [i for i in range(len(self.json["nodes"])) if i not in children]
        data = base64.b64encode(self.bytes).decode()
        buffer = {"byteLength": len(self.bytes)}
        buffer["uri"] = f"data:application/octet-stream;base64,{data}"
        return self.json | {"buffers": [buffer], "scenes": [{"nodes": roots}]}

    def write(self, path):
        path.write_text(json.dumps(self.finished()))
        return path


def of_mesh(mesh, material=None, lights=(SUN,), **arrays):
    """A file of one mesh, and lights."""
    parts = GltfParts()
    parts.node(mesh=parts.mesh(mesh, material, **arrays), name="thing")
    parts.lights(*lights)
    return parts
