//! Hot path: bounded, no allocation, no I/O, no lock.
//! Bending and twisting of the sheet: the energy of a Kirchhoff plate in finite differences.
//!
//! Curvatures are second differences of the nodes' positions as vectors: they turn with the sheet,
//! and where the sheet keeps its lengths they point along its normal, so the force is linear in the
//! positions and still valid for large rotations. Per area `D/2 (kuu² + kvv² + 2 nu kuu kvv + 2 (1 -
//! nu) kuv²)`; along a free edge, where no second difference across it exists, the curvature across
//! takes the value that leaves no moment, `kvv = -nu kuu`, which makes `D/2 (1 - nu²) kuu²`: a
//! strip bends as a beam with `E I`.

use nalgebra::Vector3;

use super::{Sheet, edge_share};

/// Adds the forces of bending and its damping to the sheet's.
pub(super) fn add_forces(sheet: &mut Sheet) {
    let plate = Plate::of(sheet);
    let time_s = sheet.material.relaxation_s;
    let Sheet {
        positions,
        velocities,
        forces,
        nodes,
        ..
    } = sheet;
    let at = |index: usize| positions[index] + velocities[index] * time_s;
    let row = nodes[0];
    for j in 0..nodes[1] {
        for i in 0..row {
            let here = j * row + i;
            let inner_u = i > 0 && i + 1 < row;
            let inner_v = j > 0 && j + 1 < nodes[1];
            match (inner_u, inner_v) {
                (true, true) => {
                    let middle = at(here) * 2.0;
                    let u = at(here - 1) - middle + at(here + 1);
                    let v = at(here - row) - middle + at(here + row);
                    let along_u = u * plate.uu + v * plate.cross;
                    let along_v = v * plate.vv + u * plate.cross;
                    spread(forces, here, 1, &along_u);
                    spread(forces, here, row, &along_v);
                }
                (true, false) => {
                    let u = at(here - 1) - at(here) * 2.0 + at(here + 1);
                    spread(forces, here, 1, &(u * plate.edge_uu));
                }
                (false, true) => {
                    let v = at(here - row) - at(here) * 2.0 + at(here + row);
                    spread(forces, here, row, &(v * plate.edge_vv));
                }
                (false, false) => {}
            }
            if i + 1 < row && j + 1 < nodes[1] {
                let twist =
                    (at(here) - at(here + 1) - at(here + row) + at(here + row + 1)) * plate.twist;
                forces[here] -= twist;
                forces[here + 1] += twist;
                forces[here + row] += twist;
                forces[here + row + 1] -= twist;
            }
        }
    }
}

/// The force of one second difference whose moment is `moment`.
#[inline]
fn spread(forces: &mut [Vector3<f64>], here: usize, stride: usize, moment: &Vector3<f64>) {
    forces[here - stride] -= moment;
    forces[here] += moment * 2.0;
    forces[here + stride] -= moment;
}

/// Stiffnesses between differences of positions, N/m.
struct Plate {
    uu: f64,
    vv: f64,
    cross: f64,
    edge_uu: f64,
    edge_vv: f64,
    twist: f64,
}

impl Plate {
    fn of(sheet: &Sheet) -> Self {
        let [u, v] = sheet.spacing_m;
        let nu = sheet.material.poisson;
        let scale = sheet.material.bend_n_m() * u * v;
        let beam = 0.5 * scale * (1.0 - nu * nu);
        Self {
            uu: scale / (u * u * u * u),
            vv: scale / (v * v * v * v),
            cross: nu * scale / (u * u * v * v),
            edge_uu: beam / (u * u * u * u),
            edge_vv: beam / (v * v * v * v),
            twist: 2.0 * (1.0 - nu) * scale / (u * u * v * v),
        }
    }
}

/// Elastic energy of bending, J.
pub(super) fn energy_j(sheet: &Sheet) -> f64 {
    let plate = Plate::of(sheet);
    let at = &sheet.positions;
    let row = sheet.nodes[0];
    let mut sum = 0.0;
    for j in 0..sheet.nodes[1] {
        for i in 0..row {
            let here = j * row + i;
            let (inner_u, inner_v) = (
                edge_share(i, row) > 0.75,
                edge_share(j, sheet.nodes[1]) > 0.75,
            );
            let difference = |stride: usize| at[here - stride] - at[here] * 2.0 + at[here + stride];
            if inner_u && inner_v {
                let (u, v) = (difference(1), difference(row));
                sum += plate.uu * u.norm_squared()
                    + plate.vv * v.norm_squared()
                    + 2.0 * plate.cross * u.dot(&v);
            } else if inner_u {
                sum += plate.edge_uu * difference(1).norm_squared();
            } else if inner_v {
                sum += plate.edge_vv * difference(row).norm_squared();
            }
            if i + 1 < row && j + 1 < sheet.nodes[1] {
                let twist = at[here] - at[here + 1] - at[here + row] + at[here + row + 1];
                sum += plate.twist * twist.norm_squared();
            }
        }
    }
    0.5 * sum
}
