#!/usr/bin/env python3
"""What `trocar anatomy` writes, judged by programs that share no code with it.

    .ci/setup-anatomy.sh                                     # nibabel, SimpleITK, trimesh, usd-core; gltf-validator by npm
    cargo build --locked -p trocar
    target/anatomy/bin/python tests/scripts/anatomy.py target/scratch/anatomy
    target/anatomy/bin/python tests/scripts/anatomy.py --short target/scratch/anatomy-short     # of 96x96x115 voxels, in `make test`

A phantom is made and built into the given folder (`--size`, `--seed`), and once more from the same labels stored with other axes. Then
(`--short`: nifti, meshes, usd, gltf, textures and planted):

  nifti    nibabel and SimpleITK read labels and CT alike and place ten landmarks at the same points of the world
  meshes   closed and wound outwards in trimesh; volumes within 1 % of the voxels'; centres where the voxels' centres are; no vertex
           farther than a voxel's diagonal from the faces of its voxels; Dice of labels and re-voxelised mesh; no two triangles of a
           mesh cross
  usd      usd-core opens the stage, UsdValidation finds no error (its report stays as usd_validation.json); units, up axis, semantics,
           masses, bound materials; the package opens as the stage does
  tetra    (not in the short form) UsdGeomTetMesh finds no inverted element and the same surface; volumes within 1 % of the meshes'
  gltf     the Khronos validator has neither error nor warning; trimesh sees the same bounds as in the stage
  textures  the textured files are as valid as the others, and every group's texture is found
  foreign  a stage that usd-core wrote, in centimetres and y upwards, turned and scaled by operations, alone and in a package, is the patient that
           it was made of, under a needle lift's expert; its binary form is refused
  planted  a stage without default prim, a glTF file with an index out of range, and triangles that cross are caught by these judges
  dicom    the CT written as a DICOM series by SimpleITK is segmented as the NIfTI is, and its labels come to lie at the same places; a
           series without one of its slices is refused
  others   label volumes of TotalSegmentator that no one here made become closed meshes too; a scanner's DICOM series, which is
           compressed, is refused with a hint
  axes     stored with its axes permuted and reversed the patient comes to lie at the same place

The script prints how far the two sides are apart, and fails beyond the tolerances below.
"""

import argparse
import json
import os
import shutil
import struct
import subprocess
import sys
import tomllib
import zipfile
from collections import namedtuple
from pathlib import Path

import nibabel
import numpy as np
import SimpleITK
import trimesh
from pxr import Usd, UsdGeom, UsdPhysics, UsdSemantics, UsdShade, UsdUtils, UsdValidation, Vt
from scipy.spatial import cKDTree

from mesh_checks import crossings, dice, voxelised

ROOT = Path(__file__).resolve().parents[2]
TROCAR = os.environ.get("TROCAR", str(ROOT / "target/debug/trocar"))
OTHERS = ROOT / "target/anatomy/others"
VALIDATOR = ROOT / "target/anatomy/node_modules/gltf-validator"
VALIDATE = """
const validator = require(process.argv[1]);
validator.validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[2]))).then(report => console.log(JSON.stringify(report.issues)));
"""
# A place in the world as float32 of some hundred mm.
PLACE_MM = 1e-3
# Of a mesh's volume to its voxels'.
VOLUME = 0.01
# Of a mesh's centre to its voxels', in voxels; of its vertices to the faces of its voxels, in a voxel's diagonals; of one less Dice with the
# labels that it was made of; of triangles that cross.
Quality = namedtuple("Quality", "centre diagonals dice crossings")
PHANTOM = Quality(0.5, 1.0, 0.02, 0)
# A scan's labels have crumbs, holes, and voxels that meet at an edge, which the repairs change: of ribs of 3 mm voxels a tenth.
SCAN = Quality(1.5, 2.0, 0.05, 0)
# Of positions as float32, m.
METRES = 1e-6
# Height of the organ above the ground of the scene, in the mean over the patch, and how far its middle may be from that, for an organ is
# round, m.
RAISED_M = 5e-3
ROUND_M = 8e-3
# The patch, and its front to the mean of the surface's normals there.
RADIUS_M = 0.03
FRONT_DEGREES = 10
# Between patches of stages whose vertices have the same order, m.
PATCH_M = 1e-4
failures = []


def report(what, found, tolerance):
    good = bool(found <= tolerance)
    print(f"{what:<72} {found:.3g} (at most {tolerance:.3g}){'' if good else '  FAILED'}", flush=True)
    if not good:
        failures.append(what)


def trocar(*words):
    subprocess.run([TROCAR, "anatomy", *map(str, words)], check=True)


def check_nifti(path, random):
    ours = nibabel.load(path)
    theirs = SimpleITK.ReadImage(str(path))
    values = SimpleITK.GetArrayFromImage(theirs).transpose(2, 1, 0)
    report(f"{path.name}: voxels of nibabel that SimpleITK has otherwise", np.count_nonzero(np.asarray(ours.dataobj) != values), 0)
    worst = 0.0
    for _ in range(10):
        voxel = [int(random.integers(side)) for side in ours.shape]
        ras = nibabel.affines.apply_affine(ours.affine, voxel)
        lps = theirs.TransformIndexToPhysicalPoint(voxel)
        worst = max(worst, np.abs(ras - np.array(lps) * [-1, -1, 1]).max())
    report(f"{path.name}: ten landmarks apart, mm", worst, PLACE_MM)
    return ours


def group_volumes(image, table):
    """By group: its voxels' mask."""
    table = tomllib.loads((ROOT / f"config/anatomy/{table}.toml").read_text())["groups"]
    labels = np.asarray(image.dataobj)
    return {name: np.isin(labels, [int(label) for label in members]) for name, members in table.items()}


def boundary_faces(mask, affine):
    """Middles of the faces around a mask, in the world."""
    padded = np.pad(mask, 1)
    middles = []
    for axis in range(3):
        faces = np.argwhere(np.diff(padded.astype(np.int8), axis=axis) != 0).astype(float)
        faces[:, axis] += 0.5
        middles.append(faces - 1.0)
    return nibabel.affines.apply_affine(affine, np.concatenate(middles))


def stage_meshes(stage):
    """By group: the mesh as it is in the stage, m."""
    meshes = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            mesh = UsdGeom.Mesh(prim)
            points = np.array(mesh.GetPointsAttr().Get(), dtype=float)
            faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
            meshes[prim.GetName().replace("_", "-")] = trimesh.Trimesh(points, faces, process=False)
    return meshes


def check_meshes(folder, image, meshes, table="vista3d", bounds=PHANTOM):
    voxel_mm3 = abs(np.linalg.det(image.affine[:3, :3]))
    diagonal = np.linalg.norm(nibabel.affines.voxel_sizes(image.affine))
    made = {group["name"]: group for group in json.loads((folder / "patient.json").read_text())["groups"]}
    masks = {name: mask for name, mask in group_volumes(image, table).items() if mask.any()}
    voxel_from_world = np.linalg.inv(image.affine)
    crossed = pairs = 0
    report("groups with voxels and without a mesh", len(masks.keys() - meshes.keys()), 0)
    for name, mask in masks.items():
        mesh = meshes[name]
        report(f"{name}: open or misdirected surfaces", int(not mesh.is_watertight) + int(not mesh.is_winding_consistent), 0)
        volume = mask.sum() * voxel_mm3
        report(f"{name}: volume of the mesh to the voxels'", abs(mesh.volume * 1e9 / volume - 1), VOLUME)
        report(f"{name}: volume in the report to trimesh's", abs(made[name]["mesh_mm3"] / (mesh.volume * 1e9) - 1), 1e-4)
        centre = nibabel.affines.apply_affine(image.affine, np.argwhere(mask).mean(axis=0))
        apart = np.abs(mesh.center_mass * 1e3 - centre).max() / nibabel.affines.voxel_sizes(image.affine).min()
        report(f"{name}: centre from the voxels' centre, voxels", apart, bounds.centre)
        distances, _ = cKDTree(boundary_faces(mask, image.affine)).query(mesh.vertices * 1e3)
        report(f"{name}: farthest vertex from a face of its voxels, voxel diagonals", distances.max() / diagonal, bounds.diagonals)
        filled = voxelised(nibabel.affines.apply_affine(voxel_from_world, mesh.vertices * 1e3), mesh.faces, mask.shape)
        report(f"{name}: Dice of labels and re-voxelised mesh from 1", 1 - dice(mask, filled), bounds.dice)
        found, looked_at = crossings(mesh.vertices, mesh.faces)
        crossed, pairs = crossed + len(found), pairs + looked_at
    report(f"all groups: crossings of {pairs} pairs of near triangles", crossed, bounds.crossings)


def validators():
    return UsdValidation.ValidationRegistry().GetOrLoadAllValidators()


def stage_errors(path):
    stage = Usd.Stage.Open(str(path))
    return stage, UsdValidation.ValidationContext(validators()).Validate(stage)


def check_stage(path):
    stage, errors = stage_errors(path)
    kept = {
        "stage": path.name,
        "usd": ".".join(map(str, Usd.GetVersion())),
        "validators": sorted(validator.GetMetadata().name for validator in validators()),
        "errors": [error.GetErrorAsString() for error in errors],
    }
    (path.parent / "usd_validation.json").write_text(json.dumps(kept, indent=1) + "\n")
    report("stage: validators that did not run, of 20 at least", max(0, 20 - len(kept["validators"])), 0)
    report("stage: metres per unit from 1", abs(UsdGeom.GetStageMetersPerUnit(stage) - 1), 0)
    report("stage: up axes that are not z", int(UsdGeom.GetStageUpAxis(stage) != UsdGeom.Tokens.z), 0)
    for error in errors:
        print(f"  {error.GetErrorAsString()}")
    report("stage: issues of UsdValidation", len(errors), 0)
    lacking = 0
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            classes = UsdSemantics.LabelsAPI(prim, "class").GetLabelsAttr().Get()
            material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
            mass = UsdPhysics.MassAPI(prim).GetMassAttr().Get()
            complete = len(classes) == 1 and material and mass > 0 and prim.HasAPI(UsdPhysics.CollisionAPI)
            lacking += int(not complete)
    report("stage: meshes without label, material, mass or collider", lacking, 0)
    soft = [prim for prim in stage.Traverse() if prim.IsA(UsdShade.Material)]
    moduli = [prim.GetAttribute("physxDeformableBodyMaterial:youngsModulus").Get() or 0 for prim in soft]
    report("stage: materials without Young's modulus", sum(modulus <= 0 for modulus in moduli), 0)
    return stage


def check_levels(path, meshes, levels):
    stage, errors = stage_errors(path)
    report("levels: issues of UsdValidation", len(errors), 0)
    variants = stage.GetDefaultPrim().GetVariantSet("LOD")
    names = [f"LOD{level}" for level in range(levels + 1)]
    report("levels: variants that are not the finest and the coarser ones", int(variants.GetVariantNames() != names), 0)
    before = float("inf")
    for name in names:
        variants.SetVariantSelection(name)
        found = stage_meshes(stage)
        triangles = sum(len(mesh.faces) for mesh in found.values())
        report(f"levels: {name}: triangles to the level before", triangles / before, 0.9)
        before = triangles
        report(f"levels: {name}: groups that the finest has not, or lack", len(found.keys() ^ meshes.keys()), 0)
        open_ones = [group for group, mesh in found.items() if not mesh.is_watertight]
        report(f"levels: {name}: open surfaces", len(open_ones), 0)
        off = max(abs(mesh.volume / meshes[group].volume - 1) for group, mesh in found.items())
        report(f"levels: {name}: volume to the finest's", off, 2 * VOLUME)
    # A quarter less a level, in the mean of them: of coarse voxels the first level's bound leaves out less.
    finest = sum(len(mesh.faces) for mesh in meshes.values())
    report("levels: the coarsest's triangles to the finest's", triangles / finest, 0.75**levels)


def check_package(path, meshes):
    stage, errors = stage_errors(path)
    report("package: issues of UsdValidation", len(errors), 0)
    with zipfile.ZipFile(path) as archive:
        report("package: files with another checksum, or compressed", int(archive.testzip() is not None) + sum(i.compress_type for i in archive.infolist()), 0)
    packed = stage_meshes(stage)
    report("package: meshes that the stage has not", len(packed.keys() ^ meshes.keys()), 0)
    report("package: vertices from the stage's, m", max(np.abs(packed[name].vertices - meshes[name].vertices).max() for name in meshes), 0)


def check_tetrahedra(path, meshes):
    stage, errors = stage_errors(path)
    report("tetra: issues of UsdValidation", len(errors), 0)
    filled = {prim.GetName().replace("_", "-"): UsdGeom.TetMesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.TetMesh)}
    report("tetra: groups that have none", len(meshes.keys() - filled.keys()), 0)
    for name, tetrahedra in filled.items():
        points = np.array(tetrahedra.GetPointsAttr().Get(), dtype=float)
        a, b, c, d = (points[corner] for corner in np.array(tetrahedra.GetTetVertexIndicesAttr().Get()).T)
        volume = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a).sum() / 6
        report(f"{name}: volume of {len(a)} tetrahedra to the mesh's", abs(volume / meshes[name].volume - 1), VOLUME)
        report(f"{name}: inverted tetrahedra", len(UsdGeom.TetMesh.FindInvertedElements(tetrahedra)), 0)

        def turned(faces):
            return {tuple(np.roll(face, -int(np.argmin(face)))) for face in np.array(faces)}

        own = turned(tetrahedra.GetSurfaceFaceVertexIndicesAttr().Get())
        report(f"{name}: faces that are not of the surface", len(own ^ turned(UsdGeom.TetMesh.ComputeSurfaceFaces(tetrahedra))), 0)


def gltf_issues(path):
    done = subprocess.run(["node", "-e", VALIDATE, str(VALIDATOR), str(path)], check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def check_gltf(path, meshes):
    scene = trimesh.load(path)
    report("glTF: meshes that the stage has not", len(scene.geometry.keys() ^ meshes.keys()), 0)
    # glTF has y upwards and z forward: left, head, front.
    bounds = np.array([mesh.bounds for mesh in meshes.values()])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    expected = np.array([[-high[0], low[2], low[1]], [-low[0], high[2], high[1]]])
    report("glTF: bounds from the stage's, m", np.abs(scene.bounds - expected).max(), METRES)
    issues = gltf_issues(path)
    for message in issues["messages"]:
        if message["severity"] < 2:
            print(f"  {message}")
    report("glTF: errors of the Khronos validator", issues["numErrors"], 0)
    report("glTF: its warnings", issues["numWarnings"], 0)


def check_textures(folder, meshes):
    path = folder / "patient-textured.usdz"
    check_package(path, meshes)
    check_gltf(folder / "patient-textured.glb", meshes)
    data = (folder / "patient-textured.glb").read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document, numbers = json.loads(data[20 : 20 + length]), data[28 + length :]
    without = 0
    for material in document["materials"]:
        texture = document["textures"][material["pbrMetallicRoughness"]["baseColorTexture"]["index"]]
        view = document["bufferViews"][document["images"][texture["source"]]["bufferView"]]
        png = numbers[view["byteOffset"] :][: view["byteLength"]]
        without += int(png[:8] != b"\x89PNG\r\n\x1a\n" or struct.unpack_from(">II", png, 16) != (256, 256))
    report("textures: groups of the glTF without one", without, 0)
    stage = Usd.Stage.Open(str(path))
    unread = 0
    for name in meshes:
        surface = UsdShade.Shader(stage.GetPrimAtPath(f"/Patient/Materials/{name.replace('-', '_')}/Surface"))
        texture = UsdShade.Shader(surface.GetInput("diffuseColor").GetConnectedSource()[0])
        unread += int(not texture.GetInput("file").Get().resolvedPath)
    report("textures: groups of the package whose file is not found", unread, 0)


def work_on(patient, result):
    """A needle lift on the liver of a patient, by the expert."""
    scene = ["--set", f"scene.scene.patient={patient}", "--set", "scene.scene.organ=liver"]
    run = [TROCAR, "run", "--task", "needle-lift", "--policy", "expert", "--lockstep", *scene, "--json", str(result)]
    return subprocess.run(run, capture_output=True, text=True)


def write_stage(path, meshes):
    """The patient in centimetres and y upwards, each mesh in a prim that is moved, turned and scaled unevenly."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    body = UsdGeom.Xform.Define(stage, "/World/Body")
    body.AddTranslateOp().Set((10, -20, 30))
    body.AddRotateXYZOp().Set((20, -30, 40))
    body.AddScaleOp().Set((2, 3, 0.5))
    inverse = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(body.GetPrim()).GetInverse())
    for name, mesh in meshes.items():
        right, front, head = mesh.vertices.T * 100
        places = np.column_stack([-right, head, front, np.ones_like(head)]) @ inverse
        prim = UsdGeom.Mesh.Define(stage, f"/World/Body/{name.replace('-', '_').title()}")
        prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(places[:, :3].astype(np.float32)))
        prim.CreateFaceVertexCountsAttr([3] * len(mesh.faces))
        prim.CreateFaceVertexIndicesAttr(mesh.faces.ravel().tolist())
    stage.Save()
    return stage


def check_foreign(folder, meshes):
    """Stages of usd-core as patients."""
    other = folder / "other.usda"
    other.unlink(missing_ok=True)
    stage = write_stage(other, meshes)
    stage.Export(str(folder / "other.usdc"))
    UsdUtils.CreateNewUsdzPackage(str(other), str(folder / "other.usdz"))
    # Which of the flat places it is depends on the vertices' order in the file: a glTF file has another.
    first = None
    points, faces = trimesh.sample.sample_surface(meshes["liver"], 200_000, seed=1)
    surface = cKDTree(points)
    for place in (folder, folder / "patient.usda", other, folder / "other.usdz"):
        result = folder / "lift.json"
        done = work_on(place, result)
        report(f"foreign: {place.name}: exit code of a needle lift", done.returncode, 0)
        if done.returncode == 0:
            lie = json.loads(result.read_text())["patient"]
            up = np.array(lie["axes_in_scan"][2])
            apart, nearest = surface.query(np.array(lie["patch_in_scan_m"]) + RAISED_M * up)
            front = meshes["liver"].face_normals[faces[surface.query_ball_point(points[nearest], RADIUS_M)]].mean(axis=0)
            turned = np.degrees(np.arccos(front @ up / np.linalg.norm(front)))
            report(f"foreign: {place.name}: its patch from the liver's surface in our stage, m", apart, ROUND_M)
            report(f"foreign: {place.name}: its patch's front from that surface's, degrees", turned, FRONT_DEGREES)
            if place.suffix:
                first = lie["patch_in_scan_m"] if first is None else first
                off = np.abs(np.subtract(lie["patch_in_scan_m"], first)).max()
                report(f"foreign: {place.name}: its patch from our stage's, m", off, PATCH_M)
    refused = work_on(folder / "other.usdc", folder / "none.json")
    report("foreign: a binary stage that is taken, or refused without a hint", int(refused.returncode != 2 or "usdcat" not in refused.stderr), 0)


def check_planted(folder, meshes):
    """What is wrong on purpose must be found."""
    mesh = max(meshes.values(), key=lambda mesh: len(mesh.faces))
    pushed = mesh.vertices.copy()
    pushed[0] += 2 * (mesh.center_mass - pushed[0])
    found, _ = crossings(pushed, mesh.faces)
    report("planted: a vertex pushed through its mesh that crosses nothing", int(not found), 0)
    text = (folder / "patient.usda").read_text()
    for key in ("defaultPrim", "metersPerUnit"):
        planted = folder / f"without_{key}.usda"
        planted.write_text("".join(line for line in text.splitlines(True) if not line.strip().startswith(key)))
        _, errors = stage_errors(planted)
        report(f"planted: a stage without {key} that passes", int(not errors), 0)
    data = bytearray((folder / "patient.glb").read_bytes())
    # The last index of the last mesh.
    data[-4:] = b"\xf0\xff\xff\x7f"
    planted = folder / "planted.glb"
    planted.write_bytes(data)
    report("planted: a glTF file with an index out of range that passes", int(gltf_issues(planted)["numErrors"] == 0), 0)


def check_others(folder):
    """Label volumes of a program and of scans that are none of ours."""
    if not OTHERS.is_dir():
        print("others: the examples of TotalSegmentator are not here: NOT CHECKED")
        return
    for volume in ("example_seg", "example_seg_dicom"):
        labels, out = OTHERS / f"{volume}.nii.gz", folder / volume
        trocar("build", labels, "--groups", "totalsegmentator", "--out", out)
        stage = check_stage(out / "patient.usda")
        check_meshes(out, nibabel.load(labels), stage_meshes(stage), "totalsegmentator", SCAN)
        check_gltf(out / "patient.glb", stage_meshes(stage))
    series = [OTHERS / "example_ct_dicom", "--model", folder / "hardly_trained.safetensors", "--out", folder / "none.nii.gz"]
    refused = subprocess.run([TROCAR, "anatomy", "segment", *map(str, series)], capture_output=True, text=True)
    report("others: a JPEG 2000 series that is taken, or refused without a hint", int(refused.returncode != 2 or "gdcmconv" not in refused.stderr), 0)


def check_axes(folder, image, meshes):
    """The same labels stored from back to front, left to right, top to bottom."""
    target = nibabel.orientations.axcodes2ornt(("P", "R", "I"))
    turned = image.as_reoriented(nibabel.orientations.ornt_transform(nibabel.io_orientation(image.affine), target))
    other = folder / "turned"
    other.mkdir(exist_ok=True)
    nibabel.save(turned, other / "labels.nii.gz")
    trocar("build", other / "labels.nii.gz", "--out", other)
    again = stage_meshes(Usd.Stage.Open(str(other / "patient.usda")))
    voxel = nibabel.affines.voxel_sizes(image.affine).min() * 1e-3
    apart = max(np.abs(meshes[name].center_mass - again[name].center_mass).max() for name in meshes)
    report("axes: centres of all meshes apart, voxels", apart / voxel, PHANTOM.centre)
    volumes = max(abs(again[name].volume / meshes[name].volume - 1) for name in meshes)
    report("axes: volumes of all meshes apart", volumes, VOLUME)


def write_series(ct, folder):
    """The CT as scanners store it: a file a slice, names in no order."""
    folder.mkdir(exist_ok=True)
    image = SimpleITK.ReadImage(str(ct))
    direction = image.GetDirection()
    writer = SimpleITK.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    orientation = [direction[k] for k in (0, 3, 6, 1, 4, 7)]
    for z in range(image.GetSize()[2]):
        cut = image[:, :, z]
        tags = {
            "0008|0060": "CT",
            "0008|0016": "1.2.840.10008.5.1.4.1.1.2",
            "0008|0018": f"1.2.826.0.1.3680043.2.1125.1.{z + 1}",
            "0020|000d": "1.2.826.0.1.3680043.2.1125.2",
            "0020|000e": "1.2.826.0.1.3680043.2.1125.3",
            "0020|0032": "\\".join(f"{value:.6f}" for value in image.TransformIndexToPhysicalPoint((0, 0, z))),
            "0020|0037": "\\".join(f"{value:.6f}" for value in orientation),
            "0028|1052": "-1024",
            "0028|1053": "1",
        }
        for tag, value in tags.items():
            cut.SetMetaData(tag, value)
        writer.SetFileName(str(folder / f"{z * 37 % 1009:04}.dcm"))
        writer.Execute(cut)


def check_dicom(folder):
    """By a network that was hardly trained: what counts is that both ways give it the same."""
    small = ["--spacing-mm", 12, "--patch", 24, "--widths", "8,16", "--patients", 1, "--steps", 40, "--validate", 0]
    model = folder / "hardly_trained.safetensors"
    trocar("train-segmenter", "--out", model, *small)
    series = folder / "series"
    write_series(folder / "ct.nii.gz", series)
    for source, out in ((folder / "ct.nii.gz", "of_nifti.nii.gz"), (series, "of_dicom.nii.gz")):
        trocar("segment", source, "--model", model, "--out", folder / out)
    one, other = (nibabel.as_closest_canonical(nibabel.load(folder / name)) for name in ("of_nifti.nii.gz", "of_dicom.nii.gz"))
    report("dicom: groups that are not found at all", int(len(np.unique(np.asarray(one.dataobj))) < 2), 0)
    report("dicom: voxels labelled otherwise than of the NIfTI", np.count_nonzero(np.asarray(one.dataobj) != np.asarray(other.dataobj)), 0)
    report("dicom: places of voxels apart, mm", np.abs(one.affine - other.affine).max(), PLACE_MM)
    sorted(series.iterdir())[7].unlink()
    refused = subprocess.run([TROCAR, "anatomy", "segment", series, "--model", model, "--out", folder / "none.nii.gz"], capture_output=True)
    report("dicom: a series without one of its slices that is taken", int(refused.returncode != 2), 0)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--size")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--short", action="store_true", help="what takes longest is left out")
    options = parser.parse_args()
    if not (VALIDATOR.is_dir() and shutil.which("node")):
        sys.exit("the Khronos glTF validator is missing: run .ci/setup-anatomy.sh")
    folder = options.folder
    size = options.size or ("96x96x115" if options.short else "160x160x192")
    trocar("phantom", "--seed", options.seed, "--size", size, "--out", folder)
    tetrahedra = [] if options.short else ["--tetrahedra", 8]
    trocar("build", folder / "labels.nii.gz", "--out", folder, "--levels", 2, "--textures", 256, *tetrahedra)
    random = np.random.default_rng(options.seed)
    check_nifti(folder / "ct.nii.gz", random)
    image = check_nifti(folder / "labels.nii.gz", random)
    stage = check_stage(folder / "patient.usda")
    meshes = stage_meshes(stage)
    check_meshes(folder, image, meshes)
    check_levels(folder / "patient-levels.usda", meshes, 2)
    check_package(folder / "patient.usdz", meshes)
    check_gltf(folder / "patient.glb", meshes)
    check_textures(folder, meshes)
    check_planted(folder, meshes)
    if not options.short:
        check_tetrahedra(folder / "tetrahedra.usda", meshes)
        check_foreign(folder, meshes)
        check_axes(folder, image, meshes)
        check_dicom(folder)
        check_others(folder)
    if failures:
        sys.exit(f"{len(failures)} failed: {', '.join(failures)}")
    print("all within tolerance")


if __name__ == "__main__":
    main()
