"""What a person looks like: clothes, solid texture and the lights of the room."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import numpy as np

from twistcap._typing import Float, Float32
from twistcap.body import Body
from twistcap.studio.config import StudioConfig, stream
from twistcap.studio.shade import LATTICE_BITS

HARD_GREY = 0.47  # the grey that person and background share in hard scenes
_SKIN = np.array([[0.94, 0.78, 0.68], [0.82, 0.62, 0.50], [0.60, 0.42, 0.32], [0.40, 0.27, 0.20]])
_HAIR = np.array([[0.12, 0.09, 0.08], [0.35, 0.22, 0.13], [0.70, 0.55, 0.33], [0.55, 0.54, 0.53]])


@dataclass(frozen=True)
class Look:
    """Everything the shading kernel needs beside the geometry.

    Attributes:
        albedo: (F, 3) colour of each triangle; contrast: (F,) of the texture on it.
        lattice: (n³, 3) random values with mean 0 that the texture interpolates.
        lights: (L, 6) unit direction towards each light (world) and its colour; ambient: (3,) light from everywhere.
    """

    albedo: Float
    contrast: Float
    lattice: Float32
    lights: Float
    ambient: Float


def look(body: Body, config: StudioConfig) -> Look:
    """Dress a body and light it, as the seed says."""
    garments = garment_of_face(body, stream(config.seed, "cut"))
    palette = wardrobe(config)
    albedo = np.array([palette[g] for g in garments])
    contrast = np.where(garments == "skin", 0.11, np.where(garments == "hair", 0.14, 0.18))
    if config.one_colour:
        albedo, contrast = np.broadcast_to(palette["shirt"], albedo.shape).copy(), np.zeros(len(albedo))
    lights, ambient = _lights(stream(config.seed, "lights"))
    if config.hard:  # the same mean grey as the room's, and texture as faint as its clutter
        albedo = HARD_GREY / mean_light(lights, ambient) + 0.18 * (albedo - _mean_colour(body, albedo))
        contrast = 0.55 * contrast
    return Look(albedo, contrast, _lattice(stream(config.seed, "texture")), lights, ambient)


def garment_of_face(body: Body, rng: np.random.Generator) -> np.ndarray:
    """(F,) name of what covers each triangle: skin, shirt, trousers, shoes, hair, by the segment's name."""
    short_sleeves, shorts = rng.random() < 0.6, rng.random() < 0.35
    by_segment = [_garment(name, bool(short_sleeves), bool(shorts)) for name in body.segment_names]
    garments = np.array(by_segment, dtype="<U8")[body.face_part]
    return np.where(_scalp(body), "hair", garments)


def _garment(segment: str, short_sleeves: bool, shorts: bool) -> str:
    rules = [
        (("head", "neck", "hand", "radius"), "skin"),
        (("ulna", "forearm"), "skin" if short_sleeves else "shirt"),
        (("foot", "toe", "calc", "talus"), "shoes"),
        (("tibia", "shank"), "skin" if shorts else "trousers"),
        (("femur", "thigh", "pelvis"), "trousers"),
    ]
    return next((g for keys, g in rules if any(k in segment.lower() for k in keys)), "shirt")


def _scalp(body: Body) -> np.ndarray:
    """(F,) triangles of the head's crown and back, where hair grows (x is forward, z up)."""
    heads = [s for s, name in enumerate(body.segment_names) if "head" in name.lower()]
    on_head = np.isin(body.face_part, heads)
    if not on_head.any():
        return on_head
    centres = body.vertices[body.faces].mean(axis=1)
    low, high = centres[on_head].min(axis=0), centres[on_head].max(axis=0)
    share = (centres - low) / np.maximum(high - low, 1e-9)
    return on_head & ((share[:, 2] > 0.82) | ((share[:, 0] < 0.5) & (share[:, 2] > 0.42)))


def wardrobe(config: StudioConfig) -> dict[str, Float]:
    """Colour of each garment, RGB in [0, 1]."""
    rng = stream(config.seed, "wardrobe")
    colours = {
        "skin": _between(rng, _SKIN),
        "hair": _between(rng, _HAIR),
        "shirt": _cloth(rng, 0.3, 0.85),
        "trousers": _cloth(rng, 0.2, 0.75),
        "shoes": _cloth(rng, 0.1, 0.9),
    }
    return colours if config.colour else {name: np.full(3, _grey(c)) for name, c in colours.items()}


def _between(rng: np.random.Generator, steps: Float) -> Float:
    at = rng.uniform(0, len(steps) - 1)
    k = int(at)
    return steps[k] + (at - k) * (steps[min(k + 1, len(steps) - 1)] - steps[k])


def _cloth(rng: np.random.Generator, darkest: float, lightest: float) -> Float:
    hue, saturation, value = rng.random(), rng.uniform(0.1, 0.6), rng.uniform(darkest, lightest)
    return np.array(colorsys.hsv_to_rgb(hue, saturation, value))


def _grey(colour: Float) -> float:
    return float(colour @ np.array([0.299, 0.587, 0.114]))


def _lattice(rng: np.random.Generator) -> Float32:
    """Channels share most of their values, so that the texture is light and dark rather than a rainbow."""
    n = (1 << LATTICE_BITS) ** 3
    values = np.clip(0.96 * rng.normal(size=(n, 1)) + 0.18 * rng.normal(size=(n, 3)), -2.5, 2.5)
    return (values - values.mean()).astype(np.float32)


def _lights(rng: np.random.Generator) -> tuple[Float, Float]:
    """A key light from above and a weaker one from about the other side, slightly warm and cold."""
    azimuth = rng.uniform(0, 2 * np.pi)
    key = _light(azimuth, rng.uniform(0.6, 1.0), rng.uniform(0.46, 0.6), rng.normal(0, 0.03))
    other = _light(azimuth + rng.uniform(1.8, 4.4), rng.uniform(0.2, 0.7), rng.uniform(0.12, 0.26), rng.normal(0, 0.03))
    return np.stack([key, other]), np.full(3, rng.uniform(0.58, 0.66))


def mean_light(lights: Float, ambient: Float) -> Float:
    """(3,) light on a surface, averaged over all the directions that it may face."""
    return 0.85 * ambient + 0.25 * lights[:, 3:].sum(axis=0)


def _mean_colour(body: Body, albedo: Float) -> Float:
    """(3,) mean over the surface, by area."""
    a, b, c = np.swapaxes(body.vertices[body.faces], 0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return area @ albedo / area.sum()


def _light(azimuth: float, elevation: float, strength: float, warmth: float) -> Float:
    towards = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    return np.concatenate([towards, strength * np.array([1 + warmth, 1.0, 1 - warmth])])
