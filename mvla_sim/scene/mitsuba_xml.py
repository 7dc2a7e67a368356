"""Writing a scene in Mitsuba's XML format, as Sionna RT and Mitsuba read it."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from pathlib import Path

from mvla_sim.errors import ConfigError, OutputError
from mvla_sim.files import atomic_output
from mvla_sim.scene.placing import SceneObject
from mvla_sim.scene.shape import Shape
from mvla_sim.scene.world import Scene

__all__ = ["export_mitsuba"]

FOLDER = "meshes"


def export_mitsuba(scene: Scene, path: str | os.PathLike[str]) -> Path:
    """Write a scene as Mitsuba XML, with one PLY file an object, or part of a car, in a ``meshes`` folder beside it.

    ``sionna.rt.load_scene(path)`` opens it with the objects' names and radio materials. Sensor positions, carrier
    and bandwidth are no part of the format.

    Parameters
    ----------
    scene
        The scene.
    path
        The XML file. It appears last, so once it is there it is complete; an older one is replaced.

    Returns
    -------
    Path
        The XML file.

    Raises
    ------
    ConfigError
        A scattering pattern other than lambertian: Sionna's XML has no way to name it.
    OutputError
        The folder cannot be made or a file cannot be written.
    """
    target = Path(path)
    root = ET.Element("scene", version="2.1.0")
    for item in scene.objects:
        root.append(_material(item.name, item.settings, f"{scene.name}: objects[{item.index}]"))
    folder = target.parent / FOLDER
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made ({error.strerror or error})") from error
    for item in scene.objects:
        with atomic_output(folder / f"{item.name}.ply") as temporary:
            temporary.write_bytes(item.mesh.export(file_type="ply", vertex_normal=False))
        root.append(_shape(item))
    ET.indent(root, "  ")
    with atomic_output(target) as temporary:
        temporary.write_bytes(ET.tostring(root, encoding="us-ascii", xml_declaration=False) + b"\n")
    return target


def _surface(name: str) -> str:
    # Sionna rewrites materials whose name begins with "itu_" and refuses the bare names of ITU materials.
    return f"mat-surface-{name}"


def _material(name: str, settings: Shape, key: str) -> ET.Element:
    if settings.scattering_coefficient > 0 and settings.scattering_pattern.kind != "lambertian":
        raise ConfigError(
            f"{key}.scattering_pattern.kind = '{settings.scattering_pattern.kind}': Sionna's scene files know only "
            "'lambertian'; override it for the export"
        )
    numbers = {
        "thickness": settings.thickness_m,
        "scattering_coefficient": settings.scattering_coefficient,
        "xpd_coefficient": settings.xpd_coefficient,
    }
    if isinstance(settings.material, str):
        element = ET.Element("bsdf", type="itu-radio-material", id=_surface(name))
        ET.SubElement(element, "string", name="type", value=settings.material)
    else:
        element = ET.Element("bsdf", type="radio-material", id=_surface(name))
        numbers["relative_permittivity"] = settings.material.relative_permittivity
        numbers["conductivity"] = settings.material.conductivity_s_per_m
    for parameter, value in numbers.items():
        ET.SubElement(element, "float", name=parameter, value=repr(float(value)))
    return element


def _shape(item: SceneObject) -> ET.Element:
    element = ET.Element("shape", type="ply", id=f"mesh-{item.name}")
    ET.SubElement(element, "string", name="filename", value=f"{FOLDER}/{item.name}.ply")
    ET.SubElement(element, "boolean", name="face_normals", value="true")
    ET.SubElement(element, "ref", id=_surface(item.name), name="bsdf")
    return element
