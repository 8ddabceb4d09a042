//! Hot path: bounded, no allocation, no I/O, no lock. Stretching and shearing of the sheet:
//! bilinear cells with Green strain, plane stress, nodal quadrature.
//!
//! The four edge vectors of a cell, divided by their rest lengths, are the columns of the
//! deformation gradient at its corners; with quadrature at the corners every strain is a dot
//! product of two of them. A constant strain is exact, and no deformation but a rigid one is free.
//!
//! The law is St. Venant and Kirchhoff's in plane stress: per area
//! `k / 2 (u^2 + v^2 + 2 nu u v) + 2 g s^2`, with the Green strains `E = (F^T F - 1) / 2` along u
//! and v and in shear, at each corner of a cell. Damping is Kelvin and Voigt's: strains are taken
//! `relaxation_s` ahead by their rates.

use nalgebra::Vector3;

use super::Sheet;

/// Edge vectors of a cell over their rest lengths: along u at low and high v, along v at low and
/// high u.
struct Edges {
    u: [Vector3<f64>; 2],
    v: [Vector3<f64>; 2],
}

/// Green strains of a cell: along the u edges, along the v edges, and the shear at the corner of u
/// edge `k` and v edge `l` as `shear[k][l]`.
struct Strains {
    u: [f64; 2],
    v: [f64; 2],
    shear: [[f64; 2]; 2],
}

impl Edges {
    /// Dimensionless for positions; for velocities, rates in 1/s.
    #[inline]
    fn of(values: &[Vector3<f64>], corners: [usize; 4], per_m: [f64; 2]) -> Self {
        let [a, b, c, d] = corners;
        let (a, b, c, d) = (&values[a], &values[b], &values[c], &values[d]);
        Self {
            u: [(b - a) * per_m[0], (d - c) * per_m[0]],
            v: [(c - a) * per_m[1], (d - b) * per_m[1]],
        }
    }

    /// All 0 at rest, whatever the rotation.
    #[inline]
    fn strains(&self) -> Strains {
        let ([u0, u1], [v0, v1]) = (&self.u, &self.v);
        Strains {
            u: [
                0.5 * (u0.norm_squared() - 1.0),
                0.5 * (u1.norm_squared() - 1.0),
            ],
            v: [
                0.5 * (v0.norm_squared() - 1.0),
                0.5 * (v1.norm_squared() - 1.0),
            ],
            shear: [
                [0.5 * u0.dot(v0), 0.5 * u0.dot(v1)],
                [0.5 * u1.dot(v0), 0.5 * u1.dot(v1)],
            ],
        }
    }

    /// Adds the strain rates times `time_s`; `rates` are the velocities of the edges.
    #[inline]
    fn add_rates(&self, rates: &Self, time_s: f64, strains: &mut Strains) {
        for k in 0..2 {
            strains.u[k] += time_s * self.u[k].dot(&rates.u[k]);
            strains.v[k] += time_s * self.v[k].dot(&rates.v[k]);
            for l in 0..2 {
                let rate = self.u[k].dot(&rates.v[l]) + rates.u[k].dot(&self.v[l]);
                strains.shear[k][l] += 0.5 * time_s * rate;
            }
        }
    }
}

impl Strains {
    /// Largest component, a bound on what the stress is made from.
    #[inline]
    fn largest(&self) -> f64 {
        let [[a, b], [c, d]] = self.shear;
        let shear = a.abs().max(b.abs()).max(c.abs().max(d.abs()));
        let stretch = self.u[0]
            .abs()
            .max(self.u[1].abs())
            .max(self.v[0].abs())
            .max(self.v[1].abs());
        stretch.max(shear)
    }
}

/// Corner numbers of the cell whose lowest corner is `first`, in a grid with `row` nodes along u.
#[inline]
const fn corners(first: usize, row: usize) -> [usize; 4] {
    [first, first + 1, first + row, first + row + 1]
}

/// Adds the forces of all cells to the sheet's.
pub(super) fn add_forces(sheet: &mut Sheet) {
    let per_m = sheet.spacing_m.map(f64::recip);
    let quarter_m2 = 0.25 * sheet.spacing_m[0] * sheet.spacing_m[1];
    let stretch = sheet.material.stretch_n_m() * quarter_m2;
    let shear = 2.0 * sheet.material.shear_n_m() * quarter_m2;
    let poisson = sheet.material.poisson;
    let time_s = sheet.material.relaxation_s;
    let cap = sheet.material.tear_green();
    let row = sheet.nodes[0];
    for j in 0..sheet.nodes[1] - 1 {
        for i in 0..row - 1 {
            let at = corners(j * row + i, row);
            let edges = Edges::of(&sheet.positions, at, per_m);
            let mut e = edges.strains();
            if time_s > 0.0 {
                let rates = Edges::of(&sheet.velocities, at, per_m);
                edges.add_rates(&rates, time_s, &mut e);
            }
            let largest = e.largest();
            // Beyond the tearing strain the stress stays, so that no stretch can outrun the
            // sub-step.
            let yielding = if largest > cap { cap / largest } else { 1.0 };
            let law = Law {
                stretch: stretch * yielding,
                shear: shear * yielding,
                poisson,
            };
            let [[u0, u1], [v0, v1]] = law.edge_forces(&edges, &e);
            let [u0, u1] = [u0 * per_m[0], u1 * per_m[0]];
            let [v0, v1] = [v0 * per_m[1], v1 * per_m[1]];
            sheet.forces[at[0]] += u0 + v0;
            sheet.forces[at[1]] += v1 - u0;
            sheet.forces[at[2]] += u1 - v0;
            sheet.forces[at[3]] -= u1 + v1;
        }
    }
}

/// Stiffness of a quarter of a cell, N m.
struct Law {
    stretch: f64,
    shear: f64,
    poisson: f64,
}

impl Law {
    /// Derivatives of the cell's energy by its edge vectors, along u and along v.
    #[inline]
    fn edge_forces(&self, edges: &Edges, e: &Strains) -> [[Vector3<f64>; 2]; 2] {
        let ([u0, u1], [v0, v1]) = (&edges.u, &edges.v);
        let [[s00, s01], [s10, s11]] = e.shear;
        let by_v = self.poisson * (e.v[0] + e.v[1]);
        let by_u = self.poisson * (e.u[0] + e.u[1]);
        let (k, g) = (self.stretch, self.shear);
        [
            [
                u0 * (k * (2.0 * e.u[0] + by_v)) + v0 * (g * s00) + v1 * (g * s01),
                u1 * (k * (2.0 * e.u[1] + by_v)) + v0 * (g * s10) + v1 * (g * s11),
            ],
            [
                v0 * (k * (2.0 * e.v[0] + by_u)) + u0 * (g * s00) + u1 * (g * s10),
                v1 * (k * (2.0 * e.v[1] + by_u)) + u0 * (g * s01) + u1 * (g * s11),
            ],
        ]
    }
}

/// Elastic energy of stretching, J (below the tearing strain).
pub(super) fn energy_j(sheet: &Sheet) -> f64 {
    let quarter_m2 = 0.25 * sheet.spacing_m[0] * sheet.spacing_m[1];
    let material = &sheet.material;
    let mut sum = 0.0;
    for_cells(sheet, |e| {
        for k in 0..2 {
            for l in 0..2 {
                let (u, v, s) = (e.u[k], e.v[l], e.shear[k][l]);
                sum += material.stretch_n_m() * (u * u + v * v + 2.0 * material.poisson * u * v)
                    + 4.0 * material.shear_n_m() * s * s;
            }
        }
    });
    0.5 * quarter_m2 * sum
}

/// Largest principal Green strain of the cells' means.
pub(super) fn green_max(sheet: &Sheet) -> f64 {
    let mut largest = f64::NEG_INFINITY;
    for_cells(sheet, |e| {
        let [[a, b], [c, d]] = e.shear;
        let (u, v) = (0.5 * (e.u[0] + e.u[1]), 0.5 * (e.v[0] + e.v[1]));
        let shear = 0.25 * (a + b + c + d);
        let half = 0.5 * (u - v);
        largest = largest.max(0.5 * (u + v) + (half * half + shear * shear).sqrt());
    });
    largest
}

/// Visits the strains of each cell, the first axis fastest.
fn for_cells(sheet: &Sheet, mut visit: impl FnMut(&Strains)) {
    let per_m = sheet.spacing_m.map(f64::recip);
    let row = sheet.nodes[0];
    for j in 0..sheet.nodes[1] - 1 {
        for i in 0..row - 1 {
            visit(&Edges::of(&sheet.positions, corners(j * row + i, row), per_m).strains());
        }
    }
}
