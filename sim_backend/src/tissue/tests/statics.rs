//! Sheets at rest against closed forms.

use hal::Pose;
use nalgebra::{UnitQuaternion, Vector3};

use crate::tissue::sheet::count;
use crate::tissue::{Material, Sheet, SheetShape};

/// Silicone-like; small deflections need it stiff.
const RUBBER: Material = Material {
    thickness_m: 0.0015,
    young_pa: 1.0e5,
    poisson: 0.45,
    density_kg_m3: 1100.0,
    relaxation_s: 5e-5,
    drag_per_s: 30.0,
    tear_strain: 0.6,
};
const G: f64 = 9.81;
/// Share of gravity under which a beam sags little enough for the closed form.
const SMALL: f64 = 0.1;

/// Steps until nothing moves any more, and says how long that took.
fn come_to_rest(sheet: &mut Sheet, pull: &[(usize, Vector3<f64>)]) {
    let dt_s = 0.8 / sheet.fastest_rad_s();
    for _ in 0..2000 {
        for _ in 0..50 {
            sheet.load();
            for (node, force) in pull {
                sheet.forces[*node] += force;
            }
            sheet.accelerate(dt_s);
            sheet.drift(dt_s);
        }
        let [kinetic, ..] = sheet.energy_j();
        if kinetic < 1e-18 {
            return;
        }
    }
    panic!("still moving: {:?}", sheet.energy_j());
}

/// A strip whose u axis is `along`, its first `fixed` columns fixed.
fn strip(cells: [usize; 2], size_m: [f64; 2], material: &Material, down: Vector3<f64>, fixed: usize) -> Sheet {
    let shape = SheetShape { size_m, cells };
    let mut sheet = Sheet::new(&shape, material, &Pose::identity(), down);
    for j in 0..sheet.nodes()[1] {
        for i in 0..fixed {
            sheet.fix(sheet.node(i, j));
        }
    }
    sheet
}

#[test]
fn hanging_bar_grows_by_rho_g_l_squared_over_2e() {
    let length_m = 0.05;
    let sheet = |cells: [usize; 2]| {
        let mut sheet = strip(cells, [length_m, 0.01], &RUBBER, Vector3::x() * G, 1);
        come_to_rest(&mut sheet, &[]);
        let end = sheet.positions()[sheet.node(cells[0], cells[1] / 2)];
        end.x - length_m
    };
    let expected_m = RUBBER.density_kg_m3 * G * length_m * length_m / (2.0 * RUBBER.young_pa);
    for cells in [[10, 2], [20, 4]] {
        let sag_m = sheet(cells);
        println!("hanging {cells:?}: {sag_m:e} expected {expected_m:e} error {:.4}", sag_m / expected_m - 1.0);
        assert!((sag_m / expected_m - 1.0).abs() < 0.05);
    }
}

#[test]
fn cantilever_sags_by_rho_g_a_l_to_the_4_over_8_e_i() {
    let length_m: f64 = 0.02;
    let t = RUBBER.thickness_m;
    let expected_m =
        RUBBER.density_kg_m3 * G * SMALL * length_m.powi(4) * 12.0 / (8.0 * RUBBER.young_pa * t * t);
    let error = |free_cells: usize, across: usize| {
        // Two fixed columns hold place and slope: the wall is half way between them.
        let spacing_m = length_m / (count(free_cells) + 0.5);
        let size_m = [spacing_m * count(free_cells + 1), 0.003];
        let down = -Vector3::z() * G * SMALL;
        let mut sheet = strip([free_cells + 1, across], size_m, &RUBBER, down, 2);
        come_to_rest(&mut sheet, &[]);
        let sag_m = -sheet.positions()[sheet.node(free_cells + 1, across / 2)].z;
        println!("cantilever {free_cells} x {across}: {sag_m:e} expected {expected_m:e} error {:.4}", sag_m / expected_m - 1.0);
        sag_m / expected_m - 1.0
    };
    let (coarse, fine) = (error(10, 1), error(20, 1));
    println!("{coarse} {fine} {}", error(20, 2));
    assert!(fine.abs() < 0.05);
}

#[test]
fn frequency_bound() {
    let sheet = strip([15, 11], [0.06, 0.044], &RUBBER, Vector3::zeros(), 0);
    println!("fastest {}", sheet.fastest_rad_s());
    let _ = UnitQuaternion::<f64>::identity();
}
