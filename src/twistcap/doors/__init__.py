"""The checked doors: everything that is read from a file comes in through one of them, checked before it is believed.

`text` for text, JSON, TOML and numbers, `strict` for their tables; `schema` and `npz` for arrays; `hdf5` for result
files; `c3d`; `images` for pictures. What a door refuses is an `InputError` that names the file.
"""
