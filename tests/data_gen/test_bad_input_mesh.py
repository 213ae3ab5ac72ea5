"""Users' meshes and scene files: what is read from good ones, and one clear sentence for each kind of bad one."""

import io
import json

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial

from data_gen.scenes import load_scene
from prt_bench.errors import SceneError
from prt_bench.scene import Glossy

OBJ = "mtllib m.mtl\nv 0 0 0\nv 4 0 0\nv 4 1 0\nv 0 1 0\nusemtl red\nf 1 2 3\nusemtl blue\nf 1 3 4\n"
MTL = "newmtl red\nKd 0.8 0.1 0.1\nnewmtl blue\nKd 0.1 0.123456 0.8\n"


def write(folder, name, text):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def write_obj(folder):
    write(folder, "m.mtl", MTL)
    return write(folder, "m.obj", OBJ)


def gltf_triangle(vertices, **material):
    data = np.asarray(vertices, "<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
    views = [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}]
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"name": "paint", **material}],
        "buffers": [{"byteLength": 48, "uri": "data.bin"}],
        "bufferViews": views,
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
    }, data


def write_gltf(folder, vertices=((0, 0, 0), (1, 0, 0), (0, 1, 0)), **material):
    document, data = gltf_triangle(vertices, **material)
    write(folder, "data.bin", data)
    return write(folder, "m.gltf", json.dumps(document))


def colours(scene):
    count = len(scene.mesh.faces)
    return scene.albedo_at(np.arange(count), np.full((count, 3), 1 / 3))


def to_linear(srgb):
    value = np.asarray(srgb) / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


# Good files


def test_obj_materials_are_exact_and_the_mesh_is_scaled_with_a_note(tmp_path):
    scene = load_scene(write_obj(tmp_path))
    assert {m.name: m.albedo for m in scene.materials} == {"red": (0.8, 0.1, 0.1), "blue": (0.1, 0.123456, 0.8)}
    assert np.ptp(scene.mesh.vertices, axis=0).max() == pytest.approx(2.0)
    assert any("scaled by 0.5" in note for note in scene.notes)


def test_gltf_is_in_metres_and_keeps_its_factor_exactly(tmp_path):
    factor = [0.123456, 0.5, 0.25, 1.0]
    scene = load_scene(write_gltf(tmp_path, pbrMetallicRoughness={"baseColorFactor": factor}))
    assert scene.materials[0].albedo == (0.123456, 0.5, 0.25)
    assert np.ptp(scene.mesh.vertices, axis=0).max() == 1.0
    assert scene.notes == ()


@pytest.mark.parametrize("suffix", ["glb", "gltf", "obj", "ply", "stl"])
def test_a_mesh_without_colour_is_half_grey_in_every_format(tmp_path, suffix):
    path = tmp_path / f"box.{suffix}"
    trimesh.creation.box((2, 2, 2)).export(path)
    scene = load_scene(path)
    assert len(scene.mesh.faces) == 12
    assert np.allclose(colours(scene), 0.5 if suffix != "obj" else colours(scene)[0])
    assert scene.mesh.areas.sum() == pytest.approx(24.0)


def test_textures_are_linearised_and_looked_up(tmp_path):
    square = trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3)], process=False)
    pixels = np.zeros((8, 8, 3), np.uint8)
    pixels[:4] = (200, 100, 50)  # upper half
    pixels[4:] = (20, 40, 80)
    square.visual = trimesh.visual.TextureVisuals(
        uv=[(0.1, 0.9), (0.2, 0.9), (0.2, 0.95), (0.1, 0.8)],
        material=PBRMaterial(name="tex", baseColorTexture=Image.fromarray(pixels)),
    )
    square.export(tmp_path / "square.glb")
    scene = load_scene(tmp_path / "square.glb")
    assert np.allclose(colours(scene), to_linear((200, 100, 50)), atol=1e-6)


def test_face_colours_are_kept_face_by_face(tmp_path):
    box = trimesh.creation.box()
    painted = np.random.default_rng(0).integers(0, 256, (12, 4), dtype=np.uint8)
    box.visual.face_colors = painted
    box.export(tmp_path / "box.ply")
    scene = load_scene(tmp_path / "box.ply")
    assert np.allclose(colours(scene), to_linear(painted[:, :3]), atol=1e-6)


def test_every_node_of_the_graph_comes_in_its_place(tmp_path):
    graph = trimesh.Scene()
    mirrored = np.diag([-1.0, 1, 1, 1])
    mirrored[0, 3] = 10
    graph.add_geometry(trimesh.creation.box(), geom_name="box")
    graph.add_geometry(trimesh.creation.box(), geom_name="mirrored", transform=mirrored)
    graph.export(tmp_path / "two.glb")
    mesh = load_scene(tmp_path / "two.glb").mesh
    assert len(mesh.faces) == 24
    for centre in ((0, 0, 0), (10, 0, 0)):
        mine = np.abs(mesh.triangles.mean(axis=1) - centre).max(axis=1) < 1
        outward = np.einsum("fd,fd->f", mesh.normals[mine], mesh.triangles[mine].mean(axis=1) - centre)
        assert mine.sum() == 12
        assert np.all(outward > 0)


def test_two_sided_sheets_get_a_second_side_and_closed_bodies_a_note(tmp_path):
    sheet = load_scene(write_gltf(tmp_path, doubleSided=True))
    assert len(sheet.mesh.faces) == 2
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=PBRMaterial(name="a", doubleSided=True))
    box.export(tmp_path / "box.glb")
    closed = load_scene(tmp_path / "box.glb")
    assert len(closed.mesh.faces) == 12
    assert "encloses a volume" in closed.notes[0]


def test_default_camera_holds_the_whole_mesh(tmp_path):
    scene = load_scene(write_obj(tmp_path))
    camera = scene.camera
    forward = np.subtract(camera.target, camera.position)
    forward /= np.linalg.norm(forward)
    offset = scene.mesh.vertices - camera.position
    angle = np.degrees(np.arccos(offset @ forward / np.linalg.norm(offset, axis=1)))
    assert angle.max() < camera.fov_y / 2


def test_degenerate_triangles_are_dropped_with_a_count(tmp_path):
    path = write(tmp_path, "m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\n")
    scene = load_scene(path)
    assert len(scene.mesh.faces) == 1
    assert "dropped 1 degenerate triangle of 2" in scene.notes


# Bad meshes


@pytest.mark.parametrize("suffix", ["glb", "gltf", "obj", "ply", "stl"])
@pytest.mark.parametrize("content", [b"", b"garbage", b"\x00\xff" * 40])
def test_unreadable_files(tmp_path, suffix, content):
    path = write(tmp_path, f"bad.{suffix}", content)
    with pytest.raises(SceneError, match=r"bad.*(could not be read|no triangles)"):
        load_scene(path)


def test_truncated_glb(tmp_path):
    file = io.BytesIO()
    trimesh.creation.icosphere().export(file, file_type="glb")
    with pytest.raises(SceneError, match="could not be read"):
        load_scene(write(tmp_path, "cut.glb", file.getvalue()[:-5000]))


def test_missing_files_and_unknown_formats(tmp_path):
    with pytest.raises(SceneError, match=r"nowhere\.obj does not exist"):
        load_scene(tmp_path / "nowhere.obj")
    with pytest.raises(SceneError, match=r"nowhere\.toml does not exist"):
        load_scene(tmp_path / "nowhere.toml")
    with pytest.raises(SceneError, match=r"formats are \.glb"):
        load_scene(write(tmp_path, "m.fbx", b""))


def test_gltf_without_its_buffer(tmp_path):
    path = write_gltf(tmp_path)
    (tmp_path / "data.bin").unlink()
    with pytest.raises(SceneError, match="could not be read"):
        load_scene(path)


def test_zero_extent_points_at_draco(tmp_path):
    with pytest.raises(SceneError, match=r"zero extent.*Draco"):
        load_scene(write_gltf(tmp_path, vertices=np.zeros((3, 3))))


def test_nan_vertices(tmp_path):
    with pytest.raises(SceneError, match="not finite"):
        load_scene(write(tmp_path, "m.obj", "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n"))


@pytest.mark.parametrize("factor", [[1.5, 0, 0, 1], [0.5, -0.1, 0, 1]])
def test_impossible_albedo_in_a_mesh(tmp_path, factor):
    with pytest.raises(SceneError, match="'paint' has albedo"):
        load_scene(write_gltf(tmp_path, pbrMetallicRoughness={"baseColorFactor": factor}))
    write_obj(tmp_path)
    write(tmp_path, "m.mtl", MTL.replace("0.8 0.1 0.1", " ".join(map(str, factor[:3]))))
    with pytest.raises(SceneError, match="'red' has albedo"):
        load_scene(tmp_path / "m.obj")


def test_points_without_triangles(tmp_path):
    trimesh.PointCloud(np.random.default_rng(0).random((5, 3))).export(tmp_path / "points.ply")
    with pytest.raises(SceneError, match="no triangles"):
        load_scene(tmp_path / "points.ply")


# Scene files


def load_toml(folder, text):
    write_obj(folder)
    return load_scene(write(folder, "scene.toml", text))


def test_scene_file_overrides(tmp_path):
    scene = load_toml(
        tmp_path,
        'mesh = "m.obj"\nname = "mine"\nscale = 0.25\nup = "z"\n[camera]\nposition = [0, 1, 4]\ntarget = [0, 0, 0]\n'
        "fov_y = 30\n[materials.red]\nalbedo = [0.2, 0.3, 0.4]\ntwo_sided = true\n",
    )
    red = next(m for m in scene.materials if m.name == "red")
    assert scene.name == "mine"
    assert red.albedo == (0.2, 0.3, 0.4)
    assert len(scene.mesh.faces) == 3
    assert scene.camera.position == (0.0, 1.0, 4.0)
    assert scene.camera.fov_y == 30
    size = np.ptp(scene.mesh.vertices, axis=0)
    assert size == pytest.approx((1.0, 0.0, 0.25), abs=1e-4)  # the file's y axis now points to −z
    assert scene.notes == ()


def test_scene_file_gives_a_material_a_glossy_lobe(tmp_path):
    block = "[materials.red]\nalbedo = [0.2, 0.3, 0.4]\n[materials.red.glossy]\n"
    scene = load_toml(tmp_path, f'mesh = "m.obj"\n{block}specular = [0.3, 0.2, 0.1]\nexponent = 50\n')
    lobes = {material.name: material.glossy for material in scene.materials}
    assert lobes == {"red": Glossy((0.3, 0.2, 0.1), 50.0), "blue": None}
    assert load_toml(tmp_path, f'mesh = "m.obj"\n{block}').materials[-1].glossy == Glossy()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mehs = 'm.obj'", r"scene\.toml has an unknown key 'mehs'; did you mean 'mesh'"),
        ("mesh = 'm.obj'\nscal = 2", "'scal'; did you mean 'scale'"),
        ("mesh = 'm.obj'\n[camera]\nposition=[0,0,1]\ntarget=[0,0,0]\nfov = 3", r"'camera\.fov'; .* 'camera\.fov_y'"),
        ("mesh = 'm.obj'\n[materials.red]\nalbdo = [1,1,1]", r"'materials\.red\.albdo'; .* 'materials\.red\.albedo'"),
        ("mesh = 'm.obj'\n[materials.red]\nalbedo = [1.2,1,1]", r"materials\.red\.albedo is \[1\.2, 1, 1\]"),
        ("mesh = 'm.obj'\n[materials.red]\nalbedo = [-0.1,1,1]", "an albedo lies from 0 to 1"),
        ("mesh = 'm.obj'\n[materials.red]\nalbedo = [nan,1,1]", "an albedo lies from 0 to 1"),
        ("mesh = 'm.obj'\n[materials.red]\nalbedo = 0.5", "must be three numbers"),
        ("mesh = 'm.obj'\n[materials.red]\ntwo_sided = 1", "must be true or false"),
        (
            "mesh = 'm.obj'\n[materials.red.glossy]\nexpnent = 5",
            r"'materials\.red\.glossy\.expnent'; .*'materials\.red\.glossy\.exponent'",
        ),
        ("mesh = 'm.obj'\n[materials.red.glossy]\nexponent = 'a'", r"materials\.red\.glossy\.exponent is 'a'"),
        ("mesh = 'm.obj'\n[materials.red.glossy]\nexponent = inf", r"materials\.red\.glossy: .*perfect mirror"),
        ("mesh = 'm.obj'\n[materials.red.glossy]\nspecular = 0.5", "must be three numbers"),
        ("mesh = 'm.obj'\n[materials.red]\nglossy = true", "'glossy' must be a table"),
        (
            "mesh = 'm.obj'\n[materials.red]\nalbedo = [0.9,0.9,0.9]\n[materials.red.glossy]",
            "'red' reflects more than arrives",
        ),
        ("mesh = 'm.obj'\n[materials.green]\nalbedo = [1,1,1]", "no material 'green'; it has 'blue', 'red'"),
        ("mesh = 'm.obj'\nscale = 0", "scale is 0, but must be a number above zero"),
        ("mesh = 'm.obj'\nscale = inf", "scale is inf"),
        ("mesh = 'm.obj'\nname = 3", "name is 3"),
        ("mesh = 'm.obj'\nup = 'w'", "one of x, y, z"),
        ("mesh = 'm.obj'\ncamera = 3", "'camera' must be a table"),
        ("mesh = 'm.obj'\n[camera]\nposition = [0, 0, 1]", "the camera needs a target"),
        ("mesh = 'm.obj'\n[camera]\nposition=[0,0,1]\ntarget=[0,0,0]\nfov_y = 180", "between 0 and 180"),
        ("mesh = 'gone.obj'", r"gone\.obj does not exist"),
        ("name = 'x'", "names no mesh"),
        ("mesh = ", "not valid TOML"),
    ],
)
def test_bad_scene_files(tmp_path, text, message):
    with pytest.raises(SceneError, match=message):
        load_toml(tmp_path, text)
