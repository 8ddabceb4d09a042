//! OpenUSD as text: a prim a group, with material, semantics and collider.
//!
//! Text, so that a diff shows what changed and no library is needed. `/Patient` has `Materials` and
//! one `Mesh` per group; points are RAS metres, z up, as the head of the stage says, so nothing is
//! turned. Numbers are the shortest that read back the same.

use std::fmt::Write as _;

use super::{Asset, extent};
use crate::groups::Group;

/// Numbers that are written on a line.
const PER_LINE: usize = 12;

/// `name` as a prim's name.
pub(super) fn prim(name: &str) -> String {
    name.replace('-', "_")
}

/// `key = [items]`, some on a line.
///
/// `after` follows the closing bracket: the metadata of a primvar.
pub(super) fn list(text: &mut String, key: &str, items: impl Iterator<Item = String>, after: &str) {
    let _written = write!(text, "        {key} = [");
    for (i, item) in items.enumerate() {
        let between = match i {
            0 => "",
            _ if i.is_multiple_of(PER_LINE) => ",\n            ",
            _ => ", ",
        };
        text.push_str(between);
        text.push_str(&item);
    }
    let _written = writeln!(text, "]{after}");
}

/// Three numbers as a tuple.
pub(super) fn vector(v: [f32; 3]) -> String {
    let [x, y, z] = v;
    format!("({x}, {y}, {z})")
}

/// The file of a group's texture, from the stage's folder.
#[must_use]
pub fn texture_file(group: &Group) -> String {
    format!("textures/{}.png", group.name)
}

/// The shaders that read a group's texture.
fn sampler(group: &Group) -> String {
    let (name, file) = (prim(&group.name), texture_file(group));
    let [r, g, b] = group.colour;
    format!(
        r#"
            def Shader "Texture"
            {{
                uniform token info:id = "UsdUVTexture"
                asset inputs:file = @{file}@
                float4 inputs:fallback = ({r}, {g}, {b}, 1)
                token inputs:sourceColorSpace = "sRGB"
                float2 inputs:st.connect = </Patient/Materials/{name}/Coordinates.outputs:result>
                token inputs:wrapS = "clamp"
                token inputs:wrapT = "clamp"
                float3 outputs:rgb
            }}

            def Shader "Coordinates"
            {{
                uniform token info:id = "UsdPrimvarReader_float2"
                string inputs:varname = "st"
                float2 outputs:result
            }}
"#
    )
}

/// A `UsdPreviewSurface`, and the stiffness on the same prim.
fn material(text: &mut String, asset: &Asset<'_>) {
    let group = asset.group;
    let name = prim(&group.name);
    let [r, g, b] = group.colour;
    let (diffuse, sampled) = match asset.texture {
        Some(_) => (
            format!(
                "color3f inputs:diffuseColor.connect = </Patient/Materials/{name}/Texture.outputs:rgb>"
            ),
            sampler(group),
        ),
        None => (
            format!("color3f inputs:diffuseColor = ({r}, {g}, {b})"),
            String::new(),
        ),
    };
    let _written = write!(
        text,
        r#"        def Material "{name}" (
            prepend apiSchemas = ["PhysicsMaterialAPI", "PhysxDeformableBodyMaterialAPI"]
        )
        {{
{}            token outputs:surface.connect = </Patient/Materials/{name}/Surface.outputs:surface>

            def Shader "Surface"
            {{
                uniform token info:id = "UsdPreviewSurface"
                {diffuse}
                float inputs:roughness = {}
                float inputs:metallic = 0
                float inputs:clearcoat = {}
                float inputs:clearcoatRoughness = 0.15
                token outputs:surface
            }}
{sampled}        }}

"#,
        stiffness(group, 12),
        group.roughness,
        group.wetness
    );
}

/// What a body of the group's tissue does under load, `indent` spaces in: density, kg/m³, Young's
/// modulus, Pa, Poisson's ratio, damping, s. The names are `PhysX`'s, for `OpenUSD` itself has none
/// for deformable bodies.
pub(super) fn stiffness(group: &Group, indent: usize) -> String {
    let values = [
        ("physics:density", group.density_kg_m3),
        (
            "physxDeformableBodyMaterial:youngsModulus",
            group.youngs_modulus_pa,
        ),
        (
            "physxDeformableBodyMaterial:poissonsRatio",
            group.poissons_ratio,
        ),
        (
            "physxDeformableBodyMaterial:elasticityDamping",
            group.damping_s,
        ),
    ];
    let line = |(name, value): (&str, f64)| format!("{:indent$}float {name} = {value}\n", "");
    values.map(line).concat()
}

/// Normals are by vertex, texture coordinates by corner (`faceVarying`); no subdivision.
fn mesh(text: &mut String, asset: &Asset<'_>) {
    let (group, mesh) = (asset.group, asset.mesh);
    let name = prim(&group.name);
    let _written = write!(
        text,
        r#"    def Mesh "{name}" (
        prepend apiSchemas = ["MaterialBindingAPI", "SemanticsLabelsAPI:class", "PhysicsCollisionAPI", "PhysicsMeshCollisionAPI", "PhysicsMassAPI"]
        displayName = "{}"
    )
    {{
        uniform token subdivisionScheme = "none"
        uniform token orientation = "rightHanded"
        rel material:binding = </Patient/Materials/{name}>
        token[] semantics:labels:class = ["{}"]
        bool physics:collisionEnabled = true
        uniform token physics:approximation = "none"
        float physics:density = {}
        float physics:mass = {}
"#,
        group.name,
        group.name,
        group.density_kg_m3,
        asset.mass_kg()
    );
    let [r, g, b] = group.colour;
    let _written = writeln!(
        text,
        "        color3f[] primvars:displayColor = [({r}, {g}, {b})]"
    );
    let [low, high] = extent(asset.metres()).map(vector);
    let _written = writeln!(text, "        float3[] extent = [{low}, {high}]");
    list(text, "point3f[] points", asset.metres().map(vector), "");
    let normals = mesh.normals.iter().copied().map(vector);
    list(
        text,
        "normal3f[] normals",
        normals,
        " (\n            interpolation = \"vertex\"\n        )",
    );
    let counts = mesh.triangles.iter().map(|_| "3".to_owned());
    list(text, "int[] faceVertexCounts", counts, "");
    let indices = mesh.triangles.as_flattened().iter().map(u32::to_string);
    list(text, "int[] faceVertexIndices", indices, "");
    let uv = mesh
        .uv
        .as_flattened()
        .iter()
        .map(|[u, v]| format!("({u}, {v})"));
    list(
        text,
        "texCoord2f[] primvars:st",
        uv,
        " (\n            interpolation = \"faceVarying\"\n        )",
    );
    text.push_str("    }\n\n");
}

/// The beginning of a stage whose default prim is `name`, up to what is in that: metres, z up.
pub(super) fn stage_head(name: &str) -> String {
    format!(
        r#"#usda 1.0
(
    defaultPrim = "{name}"
    doc = "Made by trocar anatomy. Coordinates are the scan's: x right, y anterior, z superior."
    kilogramsPerUnit = 1
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "{name}" (
    kind = "component"
)
{{
"#
    )
}

/// The file of a coarser level of detail.
#[must_use]
pub fn level_file(level: u32) -> String {
    format!("patient-level-{level}.usda")
}

/// The text of a `.usda` whose `/Patient` has `patient.usda` and `coarser` further levels beside it
/// as variants of the set `LOD`: `LOD0`, the finest, which is chosen, and following.
///
/// References are to files in the same folder.
#[must_use]
pub fn levels_usda(coarser: u32) -> String {
    let head = stage_head("Patient").replace(
        "    kind = \"component\"\n)\n{",
        "    kind = \"component\"\n    variants = {\n        string LOD = \"LOD0\"\n    }\n    prepend variantSets = \"LOD\"\n)\n{",
    );
    let mut text = format!("{head}    variantSet \"LOD\" = {{\n");
    for level in 0..=coarser {
        let file = match level {
            0 => "patient.usda".to_owned(),
            _ => level_file(level),
        };
        let _written = write!(
            text,
            "        \"LOD{level}\" (\n            prepend references = @./{file}@\n        ) {{\n        }}\n"
        );
    }
    text.push_str("    }\n}\n");
    text
}

/// The text of a `.usda` with a prim a group under `/Patient`.
///
/// Each mesh is closed, its texture coordinates are a corner's own. Colliders are the triangles
/// themselves, at rest; masses are by volume and density.
#[must_use]
pub fn usda(assets: &[Asset<'_>]) -> String {
    let mut text = stage_head("Patient");
    text.push_str("    def Scope \"Materials\"\n    {\n");
    for asset in assets {
        material(&mut text, asset);
    }
    text.push_str("    }\n\n");
    for asset in assets {
        mesh(&mut text, asset);
    }
    text.push_str("}\n");
    text
}
