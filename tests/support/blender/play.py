"""Run by Blender's Python: what its import, by its defaults, makes of a GLB, BVH or USD, at some times, as NPZ.

python play.py MOTION OUT.npz TIME...
"""

import sys

import bpy
import numpy as np

source, out, *times = sys.argv[sys.argv.index(next(a for a in sys.argv if a.endswith((".glb", ".bvh", ".usd")))) :]
bpy.ops.wm.read_factory_settings(use_empty=True)
if source.endswith(".glb"):
    bpy.ops.import_scene.gltf(filepath=source)
elif source.endswith(".usd"):
    bpy.ops.wm.usd_import(filepath=source)
else:
    bpy.ops.import_anim.bvh(filepath=source)
scene, fps = bpy.context.scene, bpy.context.scene.render.fps / bpy.context.scene.render.fps_base
armature = next(o for o in bpy.data.objects if o.type == "ARMATURE")
people = [o for o in bpy.data.objects if o.type == "MESH" and o.modifiers]
action = armature.animation_data.action if armature.animation_data else None
rate = fps  # of a BVH, whose rate Blender does not take, it is told by the file itself
if source.endswith(".bvh"):
    with open(source) as file:
        rate = 1.0 / float(next(line for line in file if "Frame Time" in line).split()[-1])
first = 1.0 if source.endswith(".bvh") else 0.0
heads, vertices = [], []
for time in map(float, times):
    frame = first + time * rate
    scene.frame_set(int(np.floor(frame)), subframe=float(frame - np.floor(frame)))
    graph = bpy.context.evaluated_depsgraph_get()
    posed = armature.evaluated_get(graph)
    heads.append([posed.matrix_world @ bone.head for bone in posed.pose.bones])
    for person in people[:1]:
        shown = person.evaluated_get(graph)
        vertices.append([shown.matrix_world @ v.co for v in shown.data.vertices])
np.savez(
    out, fps=fps, frame_range=np.array(action.frame_range if action else (0, 0)),
    names=[b.name for b in armature.data.bones],
    heads=np.array(heads), vertices=np.array(vertices), people=len(people),
    parents=[b.parent.name if b.parent else "" for b in armature.data.bones],
    rest=np.array([armature.matrix_world @ b.head_local for b in armature.data.bones]),
    materials=[m.name for p in people[:1] for m in p.data.materials],
)  # fmt: skip
