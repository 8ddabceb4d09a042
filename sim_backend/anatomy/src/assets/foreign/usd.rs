//! The meshes of an OpenUSD text (`.usda`), alone or first in a package (`.usdz`), that another
//! program made: a part a `Mesh` that is seen.
//!
//! The patient's head is where the stage's up axis points to; its front is z if that is y, as in
//! glTF, and y if that is z, with the patient's right at x, as our own stages have it. Subdivision
//! surfaces are taken as their cages. A part has the colour of its `UsdPreviewSurface`, or else its
//! display colour.

mod layer;
mod package;
mod parse;
#[cfg(test)]
mod tests;
mod transform;
mod words;

use std::str;

use nalgebra::{Matrix4, Point3};

use super::{Collection, Looks, RAS, Welded};
use crate::assets::part::Part;
use crate::number::{real, single};
use layer::{FLATTEN, Layer, Prim};
use parse::layer;
use transform::local;

/// What files begin with: a text, a package, and what is not read.
const TEXT: &[u8] = b"#usda 1.";
const BINARY: &[u8] = b"PXR-USDC";

/// Whether a file that begins like this is OpenUSD's.
pub(in crate::assets) fn is_usd(file: &[u8]) -> bool {
    [TEXT, BINARY, package::MAGIC]
        .iter()
        .any(|start| file.starts_with(start))
}

/// The parts in the bytes of a file, or what is wrong with them.
pub(in crate::assets) fn of_usd(file: &[u8]) -> Result<Vec<Part>, String> {
    let file = if file.starts_with(package::MAGIC) {
        package::first_file(file)?
    } else {
        file
    };
    if file.starts_with(BINARY) {
        return Err(format!("binary OpenUSD is not read: {FLATTEN}"));
    }
    if !file.starts_with(TEXT) {
        return Err("its first file is no OpenUSD text (#usda 1.0)".to_owned());
    }
    let text = str::from_utf8(file).map_err(|error| {
        let before = &file[..error.valid_up_to()];
        let line = 1 + before.iter().filter(|byte| **byte == b'\n').count();
        format!("line {line}: it is no UTF-8")
    })?;
    let layer = layer(text)?;
    let mut stage = Matrix4::new_scaling(layer.metres_per_unit);
    if layer.up_axis == "Y" {
        stage = Matrix4::from_column_slice(&RAS).cast::<f64>() * stage;
    }
    let mut reader = Reader {
        layer: &layer,
        stage,
        open: Vec::new(),
        parts: Collection::default(),
    };
    for prim in &layer.prims {
        reader.prim(prim, &stage, None)?;
    }
    reader.parts.whole()
}

/// What has been read so far.
struct Reader<'a> {
    layer: &'a Layer<'a>,
    /// The scan's world of a place in the stage.
    stage: Matrix4<f64>,
    /// Names of the prims that it is in.
    open: Vec<&'a str>,
    parts: Collection,
}

impl<'a> Reader<'a> {
    /// Adds the meshes of `prim` and of what is in it.
    fn prim(
        &mut self,
        prim: &'a Prim<'a>,
        parent: &Matrix4<f64>,
        material: Option<&'a str>,
    ) -> Result<(), String> {
        let is_aside = matches!(prim.word("purpose"), Some("guide" | "proxy"));
        if !prim.is_active || is_aside || prim.word("visibility") == Some("invisible") {
            return Ok(());
        }
        self.open.push(prim.name);
        let material = prim.word("material:binding").or(material);
        let place = self.own(prim, parent, material).map_err(|reason| {
            let (line, path) = (prim.line, self.open.join("/"));
            format!("line {line}, /{path}: {reason}")
        })?;
        for child in &prim.children {
            self.prim(child, &place, material)?;
        }
        self.open.pop();
        Ok(())
    }

    /// Adds the mesh of `prim` if it is one, and says where the prim is.
    fn own(
        &mut self,
        prim: &Prim<'a>,
        parent: &Matrix4<f64>,
        material: Option<&str>,
    ) -> Result<Matrix4<f64>, String> {
        let own = local(prim)?;
        let before = if own.is_reset { &self.stage } else { parent };
        let place = before * own.place;
        if prim.kind == "PointInstancer" {
            return Err(format!("a PointInstancer is not read: {FLATTEN}"));
        }
        if prim.kind == "Mesh" {
            let looks = self.looks(prim, material)?;
            let unit = self.layer.metres_per_unit;
            let note = format!("the stage has metersPerUnit = {unit}");
            self.parts
                .push(prim.name, welded(prim, &place)?, looks, &note)?;
        }
        Ok(place)
    }

    fn looks(&self, prim: &Prim<'a>, material: Option<&str>) -> Result<Looks, String> {
        let subsets = || {
            let subsets = prim.children.iter().filter(|it| it.kind == "GeomSubset");
            subsets.filter_map(|it| it.word("material:binding")).next()
        };
        let surface = material.or_else(subsets).and_then(|it| self.surface(it));
        let mut looks = Looks::default();
        if let Some(colours) = prim.attribute("primvars:displayColor") {
            looks.colour = mean(&colours.numbers).unwrap_or(looks.colour);
        }
        let Some(surface) = surface else {
            return Ok(looks);
        };
        // What OpenUSD takes where a surface says nothing; a picture is not read.
        if surface.attribute("inputs:diffuseColor.connect").is_none() {
            let colour = surface.numbers("inputs:diffuseColor")?;
            looks.colour = colour.unwrap_or([0.18; 3]).map(single);
        }
        let roughness = surface.numbers("inputs:roughness")?;
        let [roughness] = roughness.unwrap_or([0.5]);
        looks.roughness = single(roughness);
        if let Some([film]) = surface.numbers("inputs:clearcoat")? {
            looks.wetness = single(film);
        }
        Ok(looks)
    }

    /// The `UsdPreviewSurface` of the material at this place.
    fn surface(&self, material: &str) -> Option<&'a Prim<'a>> {
        let output = self.at(material)?.word("outputs:surface.connect")?;
        let (shader, _output) = output.rsplit_once('.')?;
        let shader = self.at(shader)?;
        (shader.word("info:id") == Some("UsdPreviewSurface")).then_some(shader)
    }

    /// The prim at this place.
    fn at(&self, place: &str) -> Option<&'a Prim<'a>> {
        let mut names = place.strip_prefix('/')?.split('/');
        let among = |prims: &'a [Prim<'a>], name| prims.iter().find(|prim| prim.name == name);
        let first = among(&self.layer.prims, names.next()?)?;
        names.try_fold(first, |prim, name| among(&prim.children, name))
    }
}

/// The mean of some colours; none of none.
fn mean(colours: &[f64]) -> Option<[f32; 3]> {
    let (colours, _) = colours.as_chunks::<3>();
    let sum = |channel: usize| colours.iter().map(|colour| colour[channel]).sum::<f64>();
    let whole = [0, 1, 2].map(|channel| single(sum(channel) / real(colours.len())));
    (!colours.is_empty()).then_some(whole)
}

/// The triangles of a mesh at this place. Faces of more corners are fans about their first.
fn welded(prim: &Prim<'_>, place: &Matrix4<f64>) -> Result<Welded, String> {
    let list = |name| {
        let own = prim.attribute(name);
        own.ok_or_else(|| format!("it has no {name}"))
    };
    let points = list("points")?;
    let [counts, corners] = [list("faceVertexCounts")?, list("faceVertexIndices")?];
    if points.width != 3 {
        return Err("points are not three numbers each".to_owned());
    }
    let mut welded = Welded::default();
    let (points, _) = points.numbers.as_chunks::<3>();
    let own: Vec<u32> = points
        .iter()
        .map(|point| {
            let there = place.transform_point(&Point3::from(*point));
            welded.vertex(there.map(single))
        })
        .collect();
    let is_mirrored = place.fixed_view::<3, 3>(0, 0).determinant() < 0.0;
    let is_left = prim.word("orientation") == Some("leftHanded");
    let (last, mut start) = (own.len().saturating_sub(1), 0);
    for face in 0..counts.numbers.len() {
        let end = start + counts.whole(face, corners.numbers.len() - start)?;
        if end - start < 3 {
            return Err("faceVertexCounts has a face of less than 3 corners".to_owned());
        }
        let corner = |at: usize| Ok::<_, String>(own[corners.whole(at, last)?]);
        for at in start + 1..end - 1 {
            let [a, b, c] = [corner(start)?, corner(at)?, corner(at + 1)?];
            welded.triangle(if is_mirrored == is_left {
                [a, b, c]
            } else {
                [a, c, b]
            });
        }
        start = end;
    }
    if start != corners.numbers.len() {
        return Err("faceVertexIndices has more corners than faceVertexCounts says".to_owned());
    }
    Ok(welded)
}
