//! Tetrahedra as OpenUSD text: a `TetMesh` a group.

use std::fmt::Write as _;

use nalgebra::Point3;

use super::extent;
use super::usda::{list, prim, stage_head, stiffness, vector};
use crate::groups::Groups;
use crate::number::single;
use crate::tetra::Tetrahedra;

fn metres(positions: &[Point3<f64>]) -> impl Iterator<Item = [f32; 3]> + '_ {
    positions
        .iter()
        .map(|p| [p.x, p.y, p.z].map(|x| single(x * 1e-3)))
}

/// Indices between brackets.
fn numbers<const N: usize>(numbers: &[u32; N]) -> String {
    let words = numbers.map(|number| number.to_string());
    format!("({})", words.join(", "))
}

fn tet_mesh(text: &mut String, groups: &Groups, filled: &Tetrahedra) {
    let group = &groups.groups[filled.group];
    let _written = write!(
        text,
        r#"    def TetMesh "{}" (
        prepend apiSchemas = ["SemanticsLabelsAPI:class", "PhysicsMaterialAPI", "PhysxDeformableBodyMaterialAPI"]
        displayName = "{}"
    )
    {{
        uniform token orientation = "rightHanded"
        token[] semantics:labels:class = ["{}"]
{}"#,
        prim(&group.name),
        group.name,
        group.name,
        stiffness(group, 8)
    );
    let [low, high] = extent(metres(&filled.positions)).map(vector);
    let _written = writeln!(text, "        float3[] extent = [{low}, {high}]");
    list(
        text,
        "point3f[] points",
        metres(&filled.positions).map(vector),
        "",
    );
    list(
        text,
        "int4[] tetVertexIndices",
        filled.corners.iter().map(numbers),
        "",
    );
    list(
        text,
        "int3[] surfaceFaceVertexIndices",
        filled.surface.iter().map(numbers),
        "",
    );
    text.push_str("    }\n\n");
}

/// The text of a `.usda` with the tetrahedra of each group under `/Tetrahedra`, in the frame and
/// unit of the meshes.
#[must_use]
pub fn tetrahedra_usda(groups: &Groups, all: &[Tetrahedra]) -> String {
    let mut text = stage_head("Tetrahedra");
    for filled in all {
        tet_mesh(&mut text, groups, filled);
    }
    text.push_str("}\n");
    text
}
