"""Run by Blender's Python: a rigged, textured person of the bones and skin of an NPZ, exported as GLB by its defaults.

python make_rigged.py PERSON.npz OUT.glb
"""

import sys

import bpy
import numpy as np
from mathutils import Vector

source, out = sys.argv[-2:]
person = np.load(source)
bpy.ops.wm.read_factory_settings(use_empty=True)
armature = bpy.data.objects.new("Armature", bpy.data.armatures.new("Armature"))
bpy.context.collection.objects.link(armature)
bpy.context.view_layer.objects.active = armature
bpy.ops.object.mode_set(mode="EDIT")
columns = (person[key] for key in ("names", "parents", "heads", "tails"))
for name, parent, head, tail in zip(*columns, strict=True):
    bone = armature.data.edit_bones.new(str(name))
    bone.head, bone.tail, bone.roll = Vector(head), Vector(tail), 0.3  # a roll of its own, as riggers give
    if parent:
        bone.parent = armature.data.edit_bones[str(parent)]
bpy.ops.object.mode_set(mode="OBJECT")

mesh = bpy.data.meshes.new("Person")
mesh.from_pydata(person["vertices"].tolist(), [], person["faces"].tolist())
uv = mesh.uv_layers.new(name="UVMap")
corners = np.array([loop.vertex_index for loop in mesh.loops])
uv.data.foreach_set("uv", (person["vertices"][corners][:, 1:] * 0.4 + 0.5).ravel())
for name in ("Skin", "Cloth"):
    mesh.materials.append(bpy.data.materials.new(name))
mesh.polygons.foreach_set("material_index", (np.arange(len(mesh.polygons)) % 3 == 0).astype(int))
thing = bpy.data.objects.new("Person", mesh)
bpy.context.collection.objects.link(thing)
for b, name in enumerate(person["names"]):
    group = thing.vertex_groups.new(name=str(name))
    for v in np.flatnonzero(person["weights"][:, b]):
        group.add([int(v)], float(person["weights"][v, b]), "REPLACE")
thing.parent = armature
thing.modifiers.new("Armature", "ARMATURE").object = armature
bpy.ops.export_scene.gltf(filepath=out)
