//! Where a prim is in its parent, by its operations in their order.
//!
//! OpenUSD multiplies rows from the left; here are columns, so the order is from left to right, the
//! last operation first.

use nalgebra::{Matrix4, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::layer::{Attribute, Prim};

/// Most operations of a prim.
const OPERATIONS_MAX: usize = 64;

/// Where a prim is.
pub(super) struct Local {
    pub(super) place: Matrix4<f64>,
    /// Whether that is in the stage, not in its parent.
    pub(super) is_reset: bool,
}

/// Where `prim` is.
///
/// # Errors
/// An operation that is not there, not known, or has other numbers than it takes.
pub(super) fn local(prim: &Prim<'_>) -> Result<Local, String> {
    let mut local = Local {
        place: Matrix4::identity(),
        is_reset: false,
    };
    let order = prim.attribute("xformOpOrder");
    let names = order.map_or(&[][..], |order| &order.words);
    if names.len() > OPERATIONS_MAX {
        return Err(format!(
            "xformOpOrder has more than {OPERATIONS_MAX} operations"
        ));
    }
    for name in names {
        if *name == "!resetXformStack!" {
            local.place = Matrix4::identity();
            local.is_reset = true;
            continue;
        }
        let straight = name.strip_prefix("!invert!");
        let own = prim.attribute(straight.unwrap_or(name));
        let own = own.ok_or_else(|| format!("xformOpOrder has {name:.80}, which has no value"))?;
        let mut step = operation(own)?;
        if straight.is_some() {
            step = step
                .try_inverse()
                .ok_or_else(|| format!("{name:.80} has no inverse"))?;
        }
        local.place *= step;
    }
    Ok(local)
}

/// What one operation does.
fn operation(own: &Attribute<'_>) -> Result<Matrix4<f64>, String> {
    let unknown = || format!("{:.80} is no operation that is read", own.name);
    let kind = own.name.split(':').nth(1).ok_or_else(unknown)?;
    let along = |axes: &str, other: f64| {
        let mut vector = Vector3::repeat(other);
        if axes.is_empty() {
            vector = own.exactly::<3>()?.into();
        } else {
            let [value] = own.exactly()?;
            vector[axis(axes).ok_or_else(unknown)?] = value;
        }
        Ok::<_, String>(vector)
    };
    if let Some(axes) = kind.strip_prefix("translate") {
        return Ok(Translation3::from(along(axes, 0.0)?).to_homogeneous());
    }
    if let Some(axes) = kind.strip_prefix("scale") {
        return Ok(Matrix4::new_nonuniform_scaling(&along(axes, 1.0)?));
    }
    match kind {
        "rotateX" | "rotateY" | "rotateZ" => {
            let [degrees] = own.exactly()?;
            let axis = axis(&kind[6..]).ok_or_else(unknown)?;
            Ok(turn(axis, degrees).to_homogeneous())
        }
        "rotateXYZ" | "rotateXZY" | "rotateYXZ" | "rotateYZX" | "rotateZXY" | "rotateZYX" => {
            let degrees: [f64; 3] = own.exactly()?;
            let axes = kind[6..].bytes().map(|letter| usize::from(letter - b'X'));
            let turns = axes.map(|axis| turn(axis, degrees[axis]));
            // The first letter is the first to be turned about.
            let whole = turns.fold(Rotation3::identity(), |whole, next| next * whole);
            Ok(whole.to_homogeneous())
        }
        "orient" => {
            let [w, x, y, z] = own.exactly()?;
            let turn = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9);
            let turn = turn.ok_or_else(|| format!("{:.80} has no length", own.name))?;
            Ok(turn.to_homogeneous())
        }
        // Rows there are columns here.
        "transform" => Ok(Matrix4::from_column_slice(&own.exactly::<16>()?)),
        _ => Err(unknown()),
    }
}

fn axis(letter: &str) -> Option<usize> {
    ["X", "Y", "Z"].iter().position(|axis| *axis == letter)
}

fn turn(axis: usize, degrees: f64) -> Rotation3<f64> {
    let mut about = Vector3::zeros();
    about[axis] = degrees.to_radians();
    Rotation3::new(about)
}
