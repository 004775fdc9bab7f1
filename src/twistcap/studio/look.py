"""Appearance of a person: clothes, solid texture and the lights of the room."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Float, Float32
from twistcap.body import Body
from twistcap.studio.config import StudioConfig, stream

LATTICE_BITS = 5  # the texture repeats after 2⁵ lattice steps
GARMENTS = ("skin", "hair", "shirt", "trousers", "shoes")
_CONTRAST = np.array([0.11, 0.14, 0.18, 0.18, 0.18])  # of the texture on each garment
GREY = np.array([0.299, 0.587, 0.114])  # weights of red, green and blue in a grey image (ITU-R BT.601)
HARD_GREY = 0.47  # the grey of both person and background in hard scenes
_SKIN = np.array([[0.94, 0.78, 0.68], [0.82, 0.62, 0.50], [0.60, 0.42, 0.32], [0.40, 0.27, 0.20]])
_HAIR = np.array([[0.12, 0.09, 0.08], [0.35, 0.22, 0.13], [0.70, 0.55, 0.33], [0.55, 0.54, 0.53]])


@dataclass(frozen=True)
class Look:
    """What shading takes beside the geometry; see `picture.shade`.

    Attributes:
        cover: (V, G) fraction of each garment in each vertex.
        albedo: (G, 3) colour of each garment; contrast: (G,) of the texture on it.
        lattice: (n³, 3) random values with mean 0 that the texture interpolates.
        lights: (L + 1, 6) unit direction (world) and colour of each light; the last row is the ambient light.
    """

    cover: Float
    albedo: Float
    contrast: Float
    lattice: Float32
    lights: Float


def look(body: Body, config: StudioConfig) -> Look:
    """Clothes and lights of a body, by the seed."""
    cut = stream(config.seed, "cut")
    cover = garment_fractions(body, bool(cut.random() < 0.6), bool(cut.random() < 0.35))
    albedo, contrast = wardrobe(config), _CONTRAST.copy()
    lights = _lights(stream(config.seed, "lights"))
    if config.one_colour:
        albedo[:], contrast[:] = albedo[GARMENTS.index("shirt")].copy(), 0.0
    if config.hard:  # the same mean grey as the room's, and texture as faint as its clutter
        albedo = HARD_GREY / mean_light(lights) + 0.18 * (albedo - _mean_colour(body, cover, albedo))
        contrast = 0.55 * contrast
    return Look(cover, albedo, contrast, _lattice(stream(config.seed, "texture")), lights)


def garment_fractions(body: Body, short_sleeves: bool, shorts: bool) -> Float:
    """(V, G) fraction of each garment in each vertex, by the skinning weights, which makes smooth hems."""
    worn = [GARMENTS.index(_garment(name, short_sleeves, shorts)) for name in body.segment_names]
    cover = np.zeros((len(body.vertices), len(GARMENTS)))
    for k in range(body.skin_segments.shape[1]):
        np.add.at(cover, (np.arange(len(cover)), np.array(worn)[body.skin_segments[:, k]]), body.skin_weights[:, k])
    hair = _hair(body) * cover[:, 0]
    cover[:, 0] -= hair
    cover[:, GARMENTS.index("hair")] = hair
    return cover


def _garment(segment: str, short_sleeves: bool, shorts: bool) -> str:
    """The garment of a segment, by its name."""
    rules = [
        (("head", "neck", "hand", "radius"), "skin"),
        (("ulna", "forearm"), "skin" if short_sleeves else "shirt"),
        (("foot", "toe", "calc", "talus"), "shoes"),
        (("tibia", "shank"), "skin" if shorts else "trousers"),
        (("femur", "thigh", "pelvis"), "trousers"),
    ]
    return next((g for keys, g in rules if any(k in segment.lower() for k in keys)), "shirt")


def _hair(body: Body) -> Float:
    """(V,) fraction of hair on the crown and back of a head (x forward, z up), smooth across the hairline."""
    heads = [s for s, name in enumerate(body.segment_names) if "head" in name.lower()]
    on_head = np.isin(body.vertex_part, heads)
    if not on_head.any():
        return np.zeros(len(body.vertices))
    low, high = body.vertices[on_head].min(axis=0), body.vertices[on_head].max(axis=0)
    place = (body.vertices - low) / np.maximum(high - low, 1e-9)
    above = np.maximum(place[:, 2] - 0.82, np.minimum(0.5 - place[:, 0], place[:, 2] - 0.42))
    return np.where(on_head, np.clip(0.5 + 2 * above, 0.0, 1.0), 0.0)


def wardrobe(config: StudioConfig) -> Float:
    """(G, 3) colour of each garment, RGB in [0, 1]."""
    rng = stream(config.seed, "wardrobe")
    skin, hair = _between(rng, _SKIN), _between(rng, _HAIR)
    shirt, trousers, shoes = _cloth(rng, 0.3, 0.85), _cloth(rng, 0.2, 0.75), _cloth(rng, 0.1, 0.9)
    colours = np.stack([skin, hair, shirt, trousers, shoes])
    return colours if config.colour else np.repeat(colours @ GREY[:, None], 3, axis=1)


def _between(rng: np.random.Generator, steps: Float) -> Float:
    at = rng.uniform(0, len(steps) - 1)
    k = int(at)
    return steps[k] + (at - k) * (steps[min(k + 1, len(steps) - 1)] - steps[k])


def _cloth(rng: np.random.Generator, darkest: float, lightest: float) -> Float:
    return np.array(colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.1, 0.6), rng.uniform(darkest, lightest)))


def _lattice(rng: np.random.Generator) -> Float32:
    """(n³, 3) lattice; channels are strongly correlated, so that the texture varies in lightness rather than hue."""
    n = (1 << LATTICE_BITS) ** 3
    values = np.clip(0.96 * rng.normal(size=(n, 1)) + 0.18 * rng.normal(size=(n, 3)), -2.5, 2.5)
    return (values - values.mean()).astype(np.float32)


def _lights(rng: np.random.Generator) -> Float:
    """A key light from above, a weaker one from about the opposite side, slightly warm or cold, and ambient light."""

    def light(azimuth: float, elevation: float, strength: float, warmth: float) -> Float:
        towards = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        return np.concatenate([towards, strength * np.array([1 + warmth, 1.0, 1 - warmth])])

    azimuth = rng.uniform(0, 2 * np.pi)
    key = light(azimuth, rng.uniform(0.6, 1.0), rng.uniform(0.46, 0.6), rng.normal(0, 0.03))
    other = light(azimuth + rng.uniform(1.8, 4.4), rng.uniform(0.2, 0.7), rng.uniform(0.12, 0.26), rng.normal(0, 0.03))
    return np.stack([key, other, light(0.0, 0.0, rng.uniform(0.58, 0.66), 0.0)])


def mean_light(lights: Float) -> Float:
    """(3,) light on a surface, averaged over all orientations."""
    return 0.85 * lights[-1, 3:] + 0.25 * lights[:-1, 3:].sum(axis=0)


def _mean_colour(body: Body, cover: Float, albedo: Float) -> Float:
    """(3,) mean over the surface, by area."""
    a, b, c = np.swapaxes(body.vertices[body.faces], 0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return area @ albedo[np.argmax(cover[body.faces].sum(axis=1), axis=1)] / area.sum()
