//! Sheets at rest against closed forms.

use hal::Pose;
use nalgebra::Vector3;

use crate::tissue::sheet::{Sheet, SheetShape, count, longest_step_s};
use crate::tissue::{Ground, Material, TissueConfig};

use super::flap_config;
use crate::tissue::bed::Bed;

/// The flap's material, damped so that it comes to rest soon.
fn rubber() -> Material {
    Material {
        drag_per_s: 30.0,
        ..flap_config().material
    }
}

const G: f64 = 9.81;
/// Share of gravity under which a beam sags little enough for the closed form.
const SMALL: f64 = 0.1;

/// Steps until nothing moves any more.
fn come_to_rest(sheet: &mut Sheet, pull: &[(usize, Vector3<f64>)]) {
    let dt_s = 0.5 * longest_step_s(sheet.fastest_rad_s().powi(2), sheet.material.relaxation_s);
    for _ in 0..4000 {
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

/// A strip along x whose first `fixed` columns are fixed.
fn strip(
    cells: [usize; 2],
    size_m: [f64; 2],
    material: &Material,
    gravity: Vector3<f64>,
    fixed: usize,
) -> Sheet {
    let shape = SheetShape { size_m, cells };
    let mut sheet = Sheet::new(&shape, material, &Pose::identity(), gravity);
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
    let error = |cells: [usize; 2], material: &Material| {
        let mut sheet = strip(
            cells,
            [length_m, 0.01],
            material,
            Vector3::x() * (G * SMALL),
            1,
        );
        come_to_rest(&mut sheet, &[]);
        let grown_m = sheet.positions()[sheet.node(cells[0], cells[1] / 2)].x - length_m;
        let weight_pa = material.density_kg_m3 * G * SMALL * length_m;
        grown_m * 2.0 * material.young_pa / (weight_pa * length_m) - 1.0
    };
    // Without contraction across nothing is left to err; the wall hinders it near the wall.
    let plain = Material {
        poisson: 0.0,
        ..rubber()
    };
    let plain = error([10, 2], &plain);
    assert!(plain.abs() < 0.002, "{plain}");
    for cells in [[10, 2], [20, 4]] {
        let error = error(cells, &rubber());
        assert!(error.abs() < 0.05, "{cells:?}: {error}");
    }
}

#[test]
fn cantilever_sags_by_rho_g_a_l_to_the_4_over_8_e_i() {
    let (length_m, material) = (0.02_f64, rubber());
    let square_m2 = material.thickness_m * material.thickness_m;
    let expected_m = material.density_kg_m3 * G * SMALL * length_m.powi(4) * 12.0
        / (8.0 * material.young_pa * square_m2);
    let error = |free_cells: usize, across: usize, width_m: f64, poisson: f64| {
        // Two fixed columns hold place and slope: the wall is half way between them.
        let spacing_m = length_m / (count(free_cells) + 0.5);
        let size_m = [spacing_m * count(free_cells + 1), width_m];
        let down = -Vector3::z() * G * SMALL;
        let material = Material {
            poisson,
            ..material
        };
        let mut sheet = strip([free_cells + 1, across], size_m, &material, down, 2);
        come_to_rest(&mut sheet, &[]);
        let ends = [
            sheet.node(free_cells + 1, 0),
            sheet.node(free_cells + 1, across),
        ];
        let sag_m = -0.5 * (sheet.positions()[ends[0]].z + sheet.positions()[ends[1]].z);
        sag_m / expected_m - 1.0
    };
    let (coarse, fine) = (error(10, 1, 0.003, 0.45), error(20, 1, 0.003, 0.45));
    assert!(coarse.abs() < 0.02 && fine.abs() < 0.01, "{coarse} {fine}");
    let several = error(20, 2, 0.003, 0.0);
    assert!(several.abs() < 0.01, "{several}");
    // With its Poisson ratio a bar several cells wide curls across, but not at the wall, where it
    // is stiffer for that.
    let curling = error(20, 2, 0.002, 0.45);
    assert!((-0.05..0.0).contains(&curling), "{curling}");
}

/// Bar under a known pull tells Young's modulus and Poisson's ratio.
#[test]
fn pulled_bar_has_its_youngs_modulus() {
    let (material, size_m, cells) = (rubber(), [0.06, 0.012], [20, 4]);
    let mut sheet = strip(cells, size_m, &material, Vector3::zeros(), 0);
    // Held at one end only along x, but for its middle, so that it contracts freely.
    let force_n = 0.01;
    let pull: Vec<_> = (0..=cells[1])
        .flat_map(|j| {
            let share = if j == 0 || j == cells[1] { 0.5 } else { 1.0 } / count(cells[1]);
            let force = Vector3::x() * (force_n * share);
            [(sheet.node(cells[0], j), force), (sheet.node(0, j), -force)]
        })
        .collect();
    come_to_rest(&mut sheet, &pull);
    let at = |i: usize, j: usize| sheet.positions()[sheet.node(i, j)];
    let longer = (at(20, 2) - at(0, 2)).norm() / size_m[0] - 1.0;
    let narrower = 1.0 - (at(10, 4) - at(10, 0)).norm() / size_m[1];
    let stress_pa = force_n / (size_m[1] * material.thickness_m);
    // Saint Venant and Kirchhoff: the nominal stress is E e (1 + 1.5 e) to second order.
    let young_pa = stress_pa / (longer * (1.0 + 1.5 * longer));
    assert!(
        (young_pa / material.young_pa - 1.0).abs() < 0.01,
        "{young_pa}"
    );
    let ratio = narrower / longer;
    assert!((ratio / material.poisson - 1.0).abs() < 0.02, "{ratio}");
    assert!((sheet.stretch_max() - longer).abs() < 1e-3);
}

#[test]
fn fastest_oscillation_is_the_one_that_destroys_the_step_rule() {
    // The symplectic rule is stable exactly below 2 / omega.
    let material = Material {
        relaxation_s: 0.0,
        drag_per_s: 0.0,
        ..rubber()
    };
    let mut rng = crate::rng::Rng::new(1);
    for (share, stable) in [(1.9, true), (2.1, false)] {
        let mut sheet = strip([15, 12], [0.06, 0.048], &material, Vector3::zeros(), 2);
        let dt_s = share / sheet.fastest_rad_s();
        for velocity in sheet.velocities.iter_mut().skip(40) {
            *velocity = Vector3::from(std::array::from_fn::<f64, 3, _>(|_| rng.range(-1e-6, 1e-6)));
        }
        for node in (0..13).flat_map(|j| [j * 16, j * 16 + 1]) {
            sheet.fix(node);
        }
        let start: f64 = sheet.energy_j().iter().sum();
        for _ in 0..2000 {
            sheet.load();
            sheet.accelerate(dt_s);
            sheet.drift(dt_s);
        }
        let [kinetic, elastic, _] = sheet.energy_j();
        let grown = (kinetic + elastic) / start;
        assert_eq!(
            grown < 100.0,
            stable,
            "{share}: energy grew {grown:e} times"
        );
    }
}

/// A loose sheet on a slope, as gravity turned by `slope_rad`; how far it has slid after a second.
fn slid_m(config: &TissueConfig, slope_rad: f64) -> f64 {
    let gravity = Vector3::new(slope_rad.sin(), 0.0, -slope_rad.cos()) * G;
    let material = Material {
        drag_per_s: 0.0,
        ..config.material
    };
    let mut sheet = strip([15, 12], [0.06, 0.048], &material, gravity, 0);
    let low = -0.5;
    let ground = Ground::sampled([low, low], [0.5, 0.5], 0.003, |_, _| {
        -0.5 * material.thickness_m
    });
    let mut bed = Bed::new(ground, &config.ground, &sheet);
    let dt_s = 1e-3 / f64::from(config.substeps);
    let start = sheet.positions()[100];
    for _ in 0..1000 {
        bed.begin(&sheet);
        for _ in 0..config.substeps {
            sheet.load();
            bed.press(&mut sheet);
            sheet.accelerate(dt_s);
            bed.rub_as_before(&mut sheet);
            bed.rub(&mut sheet, dt_s);
            sheet.drift(dt_s);
        }
    }
    (sheet.positions()[100] - start).x
}

#[test]
fn friction_holds_below_its_angle_and_lets_slide_above() {
    let config = flap_config();
    let angle = config.ground.friction.atan();
    let held_m = slid_m(&config, 0.95 * angle);
    assert!(held_m.abs() < 2e-5, "{held_m:e}");
    let steep = 1.3 * angle;
    let expected_m = 0.5 * G * (steep.sin() - config.ground.friction * steep.cos());
    // It sinks in at first, and while it bounces it is not rubbed.
    let free_m = slid_m(&config, steep);
    assert!(
        (free_m / expected_m - 1.0).abs() < 0.05,
        "{free_m} of {expected_m}"
    );
}
