"""Exported MaterialX documents in MaterialX's own library."""

import json
import struct
import subprocess
import sys
import zlib

import MaterialX as mx
import MaterialX.PyMaterialXGenGlsl as glsl
import MaterialX.PyMaterialXGenShader as gen
import numpy as np
import pytest


@pytest.fixture(scope="module", params=["isotropic", "anisotropic"])
def material(request, tmp_path_factory):
    """A folder with a small material of our own format, grey albedos and all."""
    folder = tmp_path_factory.mktemp(request.param)

    def png(name, pixels):
        """An 8-bit RGB PNG, written by hand: the test needs no image library."""
        height, width, _ = pixels.shape
        rows = b"".join(b"\0" + row.tobytes() for row in pixels)
        chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
        data = b"\x89PNG\r\n\x1a\n"
        for kind, content in chunks:
            data += struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        (folder / name).write_bytes(data)

    generator = np.random.default_rng(3)
    noise = lambda: generator.integers(20, 235, (6, 8, 3), dtype=np.uint8)  # noqa: E731
    flat = lambda rgb: np.tile(np.array(rgb, np.uint8), (6, 8, 1))  # noqa: E731
    maps = {"diffuse": noise(), "specular": noise() // 8, "roughness": noise(), "normal": flat([128, 128, 255])}
    if request.param == "anisotropic":
        maps["tangent"] = flat([255, 128, 128])
    for name, pixels in maps.items():
        png(f"{name}.png", pixels)
    description = {
        "format": "svbrdf-gcn material",
        "version": 1,
        "patch_size": 4.0,
        "lobe": request.param,
        "maps": {name: {"file": f"{name}.png", "transfer": "linear"} for name in maps},
    }
    (folder / "material.json").write_text(json.dumps(description))
    return folder


def documents(folder):
    """The exported document, and it together with the standard libraries."""
    document, complete, libraries = mx.createDocument(), mx.createDocument(), mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), libraries)
    for read in (document, complete):
        mx.readFromXmlFile(read, str(folder / "material.mtlx"))
    complete.importLibrary(libraries)
    return document, complete


@pytest.fixture
def exported(material, tmp_path):
    command = [sys.executable, "-m", "svbrdf_gcn", "export", material, "--to", "materialx", "-o", tmp_path]
    subprocess.run(command, check=True, capture_output=True)
    return tmp_path, (material / "tangent.png").exists()


def test_documents_are_valid(exported):
    folder, anisotropic = exported
    document, complete = documents(folder)
    valid, message = complete.validate()
    assert valid, message
    surface = complete.getNode("material_surface")
    definition = surface.getNodeDef()
    assert definition is not None and definition.getNodeString() == "open_pbr_surface"
    declared = {value.getName(): value.getType() for value in definition.getActiveInputs()}
    inputs = {value.getName(): value for value in surface.getInputs()}
    assert {"base_color", "base_metalness", "specular_color", "specular_ior", "specular_roughness", "geometry_normal"} <= set(inputs)
    assert ("geometry_tangent" in inputs) == ("specular_roughness_anisotropy" in inputs) == anisotropic
    for name, value in inputs.items():
        assert value.getType() == declared[name]
        assert value.getConnectedOutput().getConnectedNode() is not None
    for node in document.getNodeGraph("maps").getNodes("image"):
        file = node.getInput("file")
        assert (folder / file.getValueString()).is_file()
        assert file.getColorSpace() == "srgb_texture" or node.getType() != "color3"
    # All of the files are used.
    images = {node.getInputValue("file") for node in document.getNodeGraph("maps").getNodes("image")}
    assert images == {path.name for path in folder.glob("*.png")}


def test_the_document_generates_a_shader(exported):
    _, complete = documents(exported[0])
    generator = glsl.GlslShaderGenerator.create()
    generator.registerTypeDefs(complete)
    colors = gen.DefaultColorManagementSystem.create(generator.getTarget())
    colors.loadLibrary(complete)
    generator.setColorManagementSystem(colors)
    context = gen.GenContext(generator)
    context.registerSourceCodeSearchPath(mx.getDefaultDataSearchPath())
    context.getOptions().targetColorSpaceOverride = "lin_rec709"
    (material,) = gen.findRenderableElements(complete)
    source = generator.generate("material", material, context).getSourceCode(gen.PIXEL_STAGE)
    for image in complete.getNodeGraph("maps").getNodes("image"):
        assert f"{image.getName()}_file" in source


def test_validation_notices_mistakes(exported):
    folder, _ = exported
    path = folder / "material.mtlx"
    path.write_text(path.read_text().replace('name="base_metalness" type="float" nodegraph', 'name="base_metalness" type="color3" nodegraph'))
    assert not documents(folder)[1].validate()[0]
