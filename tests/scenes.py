"""Small files of scene formats, with a transform each, to be damaged."""

import io
import struct
import zipfile

import numpy as np

from tests.gltf import CUBE, GltfFile

DAE = b"""<COLLADA version="1.4.1"><library_geometries><geometry id="g"><mesh><source id="s">
<float_array id="a" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array>
<technique_common><accessor source="#a" count="4" stride="3"/></technique_common>
</source><vertices id="v"><input semantic="POSITION" source="#s"/></vertices><polylist count="2">
<input semantic="VERTEX" source="#v" offset="0"/><vcount>3 3</vcount><p>0 2 1 0 1 3</p></polylist><polygons count="1">
<input semantic="VERTEX" source="#v" offset="1"/><input semantic="NORMAL" source="#v" offset="0"/>
<ph><p>0 1 0 2 0 3</p><h>0 1 0 2 0 0</h></ph></polygons></mesh></geometry></library_geometries><library_visual_scenes>
<visual_scene id="w"><node id="n"><rotate>0 0 1 90</rotate><matrix>1 0 0 2 0 1 0 0 0 0 1 0 0 0 0 1</matrix>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes></COLLADA>"""
_MODEL = """<model unit="inch"><resources><object id="1"><mesh><vertices><vertex x="0" y="0" z="0"/>
<vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/></vertices><triangles><triangle v1="0" v2="1" v3="2"/></triangles>
</mesh></object><object id="2"><components><component objectid="1" transform="1 0 0 0 1 0 0 0 -1 4 5 6"/></components>
</object></resources><build><item objectid="2"/></build></model>"""


def threemf():
    """Return a 3MF file of one triangle in an assembly."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr(zipfile.ZipInfo("3D/3dmodel.model"), _MODEL)
    return content.getvalue()


def las():
    """Return a LAS file of two points."""
    header = bytearray(227)
    header[:4], header[24:26] = b"LASF", bytes([1, 2])
    struct.pack_into("<HIIBHI", header, 94, 227, 227, 0, 0, 20, 2)
    struct.pack_into("<6d", header, 131, 0.1, 0.1, 0.1, 5, 6, 7)
    return bytes(header) + bytes(range(40))


def glb():
    """Return a binary glTF file with a skin, a morph target, a sparse accessor, a strip and a texture, at two nodes."""
    file = GltfFile()
    primitive = file.primitive(CUBE, np.arange(8, dtype="<u2"), mode=5)
    rows = np.array([1, 2], "<u2")
    file.json["accessors"][0]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": file.view(rows.tobytes()), "componentType": 5123},
        "values": {"bufferView": file.view(CUBE[rows].tobytes())},
    }
    primitive["targets"] = [{"POSITION": file.accessor(CUBE)}]
    primitive["attributes"] |= {
        "JOINTS_0": file.accessor(np.zeros((8, 4), "u1")),
        "WEIGHTS_0": file.accessor(np.full((8, 4), 63, "u1"), normalized=True),
        "TEXCOORD_0": file.accessor(CUBE[:, :2].copy()),
        "COLOR_0": file.accessor(np.full((8, 4), 63, "u1"), normalized=True),
        "_HEAT": file.accessor(CUBE[:, 0].copy()),
    }
    primitive["material"] = 0
    file.json["images"] = [{"bufferView": file.view(b"\x89PNG\r\n\x1a\n"), "mimeType": "image/png"}]
    file.json["textures"] = [{"source": 0, "sampler": 0}]
    file.json["samplers"] = [{"wrapS": 33071}]
    file.json["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    file.mesh(primitive)
    file.json["meshes"][0]["weights"] = [0.5]
    file.json["skins"] = [{"joints": [1], "inverseBindMatrices": file.accessor(np.eye(4, dtype="<f4").reshape(1, 16))}]
    file.node(mesh=0, skin=0, children=[1])
    file.node(mesh=0, translation=[1, 2, 3], rotation=[0, 0, 0, 1], scale=[-1, 1, 1])
    file.json |= {"scenes": [{"nodes": [0]}], "scene": 0}
    return file.glb()
