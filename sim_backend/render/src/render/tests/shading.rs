//! What light does: shadows that stay with the endoscope, patterns that stay with the surface,
//! edges, metal.

use nalgebra::{Point3, Vector3};

use super::*;

/// Mean of red, green and blue.
fn grey(frame: &CameraFrame, pixel: usize) -> f64 {
    let bytes = &frame.colour[3 * pixel..3 * pixel + 3];
    bytes.iter().map(|byte| f64::from(*byte)).sum::<f64>() / 3.0
}

#[test]
fn a_camera_beside_sees_the_shadow_that_the_endoscope_casts() {
    let plain = Material {
        pattern: Pattern::Smooth,
        wetness: 0.0,
        ..MUSCLE
    };
    let plane = || Visual::new("plane", height_field(0.1, 0.1, 3, |_, _| 0.0), plain, 1);
    let ball = Visual::new("ball", sphere(0.006, 32), STEEL, 2);
    let overhead = Camera {
        camera_in_scene: look_at(Point3::new(0.0, 0.0, 0.12), Point3::origin(), Vector3::y()),
        ..endoscope(64)
    };
    let beside = Camera {
        camera_in_scene: look_at(
            Point3::new(0.12, -0.02, 0.05),
            Point3::origin(),
            Vector3::z(),
        ),
        ..endoscope(128)
    };
    let light = Light::beside(&overhead);
    let mut with = CameraFrame::blank(beside.intrinsics);
    let mut without = with.clone();
    let centre = Point3::new(0.0, 0.0, 0.02);
    Renderer::new(&[plane(), ball])
        .unwrap()
        .render(
            &[Pose::identity(), at(0.0, 0.0, 0.02)],
            &beside,
            &light,
            &mut with,
        )
        .unwrap();
    Renderer::new(&[plane()])
        .unwrap()
        .render(&[Pose::identity()], &beside, &light, &mut without)
        .unwrap();
    let guide = light.guide_in_scene * Point3::origin();
    let (mut dark, mut bright) = (0, 0);
    for pixel in within(&with, 1) {
        let seen = ray(&beside.intrinsics, pixel) * f64::from(with.depth_m[pixel]);
        let point = beside.camera_in_scene * Point3::from(seen);
        let miss = (centre - guide).cross(&(point - guide).normalize()).norm();
        let ratio = grey(&with, pixel) / grey(&without, pixel);
        if miss < 0.005 {
            assert!(ratio < 0.8, "pixel {pixel}: {ratio}");
            dark += 1;
        } else if miss > 0.007 {
            assert!(ratio > 0.97, "pixel {pixel}: {ratio}");
            bright += 1;
        }
    }
    assert!(dark > 50 && bright > 2000, "{dark} {bright}");
}

#[test]
fn a_pattern_goes_where_its_surface_goes() {
    let patch = Visual::new("patch", height_field(0.06, 0.06, 8, |_, _| 0.0), MUSCLE, 1);
    let mut renderer = Renderer::new(&[patch]).unwrap();
    let shift = at(0.037, -0.011, 0.0);
    let camera = Camera {
        camera_in_scene: look_at(
            Point3::new(0.0, -0.03, 0.09),
            Point3::origin(),
            Vector3::z(),
        ),
        ..endoscope(96)
    };
    let moved = Camera {
        camera_in_scene: shift * camera.camera_in_scene,
        ..camera
    };
    let here = shoot(&mut renderer, &[Pose::identity()], &camera);
    let there = shoot(&mut renderer, &[shift], &moved);
    let left_behind = shoot(&mut renderer, &[Pose::identity()], &moved);
    let on_patch = |pixel: &usize| here.instance[*pixel] == 1 && left_behind.instance[*pixel] == 1;
    let pixels: Vec<usize> = (0..here.instance.len()).filter(on_patch).collect();
    let apart = |other: &CameraFrame| {
        let difference = |&pixel: &usize| (grey(&here, pixel) - grey(other, pixel)).abs();
        pixels.iter().map(difference).sum::<f64>() / pixels.len() as f64
    };
    assert!(pixels.len() > 2000, "{}", pixels.len());
    assert!(apart(&there) < 0.5, "{}", apart(&there));
    // And there is a pattern at all.
    assert!(apart(&left_behind) > 4.0, "{}", apart(&left_behind));
}

/// As two patients' livers do.
#[test]
fn another_part_of_a_pattern_looks_different() {
    let patch = Visual::new("patch", height_field(0.06, 0.06, 8, |_, _| 0.0), MUSCLE, 1);
    let shot = |at_mm: [f32; 2]| {
        let patch = patch.clone().with_pattern_at(at_mm);
        let mut renderer = Renderer::new(&[patch]).unwrap();
        shoot(&mut renderer, &[Pose::identity()], &endoscope(96))
    };
    let [middle, again, far] = [[0.0; 2], [0.0; 2], [700.0, -300.0]].map(shot);
    assert!(middle.colour == again.colour);
    assert!(middle.instance == far.instance);
    let on_patch = |pixel: &usize| middle.instance[*pixel] == 1;
    let pixels: Vec<usize> = (0..middle.instance.len()).filter(on_patch).collect();
    let difference = |&pixel: &usize| (grey(&middle, pixel) - grey(&far, pixel)).abs();
    let apart = pixels.iter().map(difference).sum::<f64>() / pixels.len() as f64;
    assert!(apart > 4.0, "{apart} over {} pixels", pixels.len());
}

#[test]
fn edges_are_smooth_in_colour_and_sharp_in_ids() {
    // Brushed without grooves, for smooth paint may be worn.
    let white = Material {
        base_colour: [0.9; 3],
        metallic: 0.0,
        detail: 0.0,
        ..STEEL
    };
    let dark = Material {
        base_colour: [0.0; 3],
        ..white
    };
    let scene = [
        Visual::new("box", cuboid(Vector3::new(0.01, 0.01, 0.001)), white, 200),
        Visual::new("wall", cuboid(Vector3::new(0.2, 0.2, 0.001)), dark, 100),
    ];
    let mut renderer = Renderer::new(&scene).unwrap();
    let camera = Camera {
        camera_in_scene: Pose::identity(),
        ..endoscope(96)
    };
    let turned = Pose::rotation(Vector3::new(0.0, 0.0, 0.3));
    let poses = [at(0.0, 0.0, 0.1) * turned, at(0.0, 0.0, 0.15)];
    let full = shoot(&mut renderer, &poses, &camera);
    renderer.set_shading(Shading::Fine);
    let fine = shoot(&mut renderer, &poses, &camera);
    assert!(fine.instance.iter().all(|id| [100, 200].contains(id)));
    // On the wall the box's shadow has an edge, too.
    let inside = within(&full, 200);
    let changed = |pixel: &usize| (grey(&full, *pixel) - grey(&fine, *pixel)).abs() > 12.0;
    let at_edges = (0..full.instance.len()).filter(changed).count();
    assert!((40..400).contains(&at_edges), "{at_edges}");
    let elsewhere = inside.iter().filter(|pixel| changed(pixel)).count();
    assert_eq!(elsewhere, 0);
    // Along the outline pixels are covered in part, and neither as bright as the box nor as dark as
    // the wall.
    let mut outline: Vec<usize> = (0..full.instance.len()).collect();
    for id in [100, 200] {
        let whole = within(&full, id);
        outline.retain(|pixel| !whole.contains(pixel));
    }
    outline.retain(|pixel| (2..94).contains(&(pixel % 96)) && (2..94).contains(&(pixel / 96)));
    let levels = |id: u8| -> Vec<f64> {
        let of = outline.iter().filter(|pixel| full.instance[**pixel] == id);
        of.map(|pixel| grey(&full, *pixel)).collect()
    };
    let darkest = levels(200).into_iter().fold(f64::MAX, f64::min);
    let brightest = levels(100).into_iter().fold(0.0, f64::max);
    let between = brightest + 4.0..darkest - 4.0;
    let blended = outline
        .iter()
        .filter(|pixel| between.contains(&grey(&fine, **pixel)))
        .count();
    assert!(blended > 30, "{blended} of {}", outline.len());
    // And none has a colour from elsewhere.
    let greatest = levels(200).into_iter().fold(0.0, f64::max) + 12.0;
    assert!(outline.iter().all(|pixel| grey(&fine, *pixel) < greatest));
}

/// Greatest difference, grey levels, between a board with that finish and an unworn one: brushed,
/// without grooves.
fn wear(shading: Shading, finish: Material) -> f64 {
    let shot = |material| {
        let board = Visual::new(
            "board",
            cuboid(Vector3::new(0.03, 0.03, 0.001)),
            material,
            1,
        );
        let opened = Renderer::with_backdrop(&[board], &Backdrop::CAVITY, shading);
        shoot(
            &mut opened.unwrap(),
            &[at(0.0, 0.0, 0.1)],
            &Camera {
                camera_in_scene: Pose::identity(),
                ..endoscope(128)
            },
        )
    };
    let unworn = shot(Material {
        detail: 0.0,
        pattern: Pattern::Brushed,
        ..finish
    });
    let worn = shot(finish);
    let board = within(&worn, 1);
    let differences = board
        .iter()
        .map(|pixel| grey(&worn, *pixel) - grey(&unworn, *pixel));
    differences.map(f64::abs).fold(0.0, f64::max)
}

#[test]
fn paint_is_worn_in_fine_pictures() {
    let steel = Material {
        pattern: Pattern::Smooth,
        ..STEEL
    };
    let paint = Material {
        base_colour: [0.3; 3],
        metallic: 0.0,
        detail: 1.0,
        ..steel
    };
    let moist = Material {
        wetness: 0.1,
        ..paint
    };
    let new = Material {
        detail: 0.0,
        ..paint
    };
    let levels = wear(Shading::Fine, paint);
    assert!((4.0..25.0).contains(&levels), "{levels}");
    for unworn in [steel, moist, new] {
        assert!(wear(Shading::Fine, unworn) < 1.0);
    }
    assert!(wear(Shading::Full, paint) < 1.0);
}

/// How many pixels of a plane below a ball at `height_m` are in penumbra: they get more light than
/// the darkest one, and less than without the ball.
fn half_lit(shading: Shading, height_m: f64) -> usize {
    let flesh = Material {
        detail: 0.0,
        pattern: Pattern::Smooth,
        ..MUSCLE
    };
    let plane = Visual::new("plane", height_field(0.1, 0.1, 3, |_, _| 0.0), flesh, 1);
    let ball = Visual::new("ball", sphere(0.004, 32), STEEL, 2);
    let camera = Camera {
        camera_in_scene: look_at(Point3::new(0.0, 0.0, 0.12), Point3::origin(), Vector3::y()),
        ..endoscope(256)
    };
    let shot = |visuals: &[Visual], poses: &[Pose]| {
        let opened = Renderer::with_backdrop(visuals, &Backdrop::CAVITY, shading);
        shoot_in(&mut opened.unwrap(), poses, &camera, &aside(&camera))
    };
    let bare = shot(core::slice::from_ref(&plane), &[Pose::identity()]);
    let shadowed = shot(&[plane, ball], &[Pose::identity(), at(0.0, 0.0, height_m)]);
    let green = |frame: &CameraFrame, pixel: usize| f64::from(frame.colour[3 * pixel + 1]);
    let shares = within(&shadowed, 1)
        .into_iter()
        .map(|pixel| green(&shadowed, pixel) / green(&bare, pixel));
    let shares: Vec<f64> = shares.collect();
    let least = shares.iter().copied().fold(1.0, f64::min);
    let half = least + 0.1..0.95;
    shares.iter().filter(|share| half.contains(share)).count()
}

#[test]
fn a_fine_shadow_of_a_higher_caster_has_a_wider_edge() {
    let [low, high] = [0.004, 0.03].map(|height_m| {
        let [full, fine] =
            [Shading::Full, Shading::Fine].map(|shading| half_lit(shading, height_m));
        fine as f64 / full as f64
    });
    // Against the edges of full shading, which are four taps wide whatever casts them.
    assert!(high > 1.6 && high > 2.5 * low && low < 1.5, "{low} {high}");
}

#[test]
fn metal_mirrors_and_flesh_is_red() {
    let (visuals, poses) = lift_scene();
    let mut renderer = Renderer::new(&visuals).unwrap();
    let frame = shoot(&mut renderer, &poses, &endoscope(256));
    let of = |id: u8| -> Vec<usize> {
        let pixels = 0..frame.instance.len();
        pixels.filter(|&p| frame.instance[p] == id).collect()
    };
    let mean = |id: u8, channel: usize| {
        let bytes: Vec<f64> = of(id)
            .into_iter()
            .map(|pixel| f64::from(frame.colour[3 * pixel + channel]))
            .collect();
        bytes.iter().sum::<f64>() / bytes.len() as f64
    };
    let red_over_green = |id| mean(id, 0) / mean(id, 1);
    assert!(red_over_green(instance::ORGAN) > 1.5);
    assert!((0.9..1.25).contains(&red_over_green(instance::NEEDLE)));
    assert!((0.9..1.25).contains(&red_over_green(instance::JAW)));
    // What mirrors has lights and darks.
    let mut needle: Vec<f64> = of(instance::NEEDLE)
        .into_iter()
        .map(|pixel| grey(&frame, pixel))
        .collect();
    needle.sort_by(f64::total_cmp);
    let (low, high) = (needle[needle.len() / 20], needle[needle.len() * 19 / 20]);
    assert!(high > 1.8 * low, "{low} {high}");
}
