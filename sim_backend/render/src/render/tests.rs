//! Images against geometry worked out by hand, and bytes against bytes.

#![expect(clippy::cast_precision_loss, reason = "pixel counts are small")]

mod labels;
mod lens;
mod shading;

use hal::{CameraFrame, Distortion, Intrinsics, Mesh, Pose};
use nalgebra::{Point3, Translation3, Vector3};

use super::*;
use crate::shapes::instrument::{Finger, finger, shaft, wrist};
use crate::shapes::{arc, cuboid, height_field, sphere, tube};
use crate::visual::{Material, Pattern, Visual, instance};

const STEEL: Material = Material {
    base_colour: [0.62, 0.62, 0.64],
    metallic: 1.0,
    roughness: 0.34,
    wetness: 0.0,
    detail: 0.5,
    pattern: Pattern::Brushed,
};
const NEEDLE: Material = Material {
    base_colour: [0.86, 0.86, 0.88],
    metallic: 1.0,
    roughness: 0.20,
    wetness: 0.0,
    detail: 0.1,
    pattern: Pattern::Smooth,
};
const MUSCLE: Material = Material {
    base_colour: [0.46, 0.085, 0.065],
    metallic: 0.0,
    roughness: 0.5,
    wetness: 0.8,
    detail: 1.0,
    pattern: Pattern::Muscle,
};

fn at(x: f64, y: f64, z: f64) -> Pose {
    Translation3::new(x, y, z).into()
}

/// An uneven lens on a tilted camera, so that no mistake in a sign or an axis cancels.
fn tilted_camera() -> Camera {
    Camera {
        intrinsics: Intrinsics {
            width: 84,
            height: 70,
            fx: 95.0,
            fy: 88.0,
            cx: 39.5,
            cy: 36.25,
            distortion: Distortion::NONE,
        },
        camera_in_scene: look_at(
            Point3::new(0.05, -0.08, 0.11),
            Point3::new(0.004, 0.006, 0.0),
            Vector3::z(),
        ),
        near_m: 0.01,
        far_m: 1.0,
        optics: Optics::CLEAN,
    }
}

fn shoot(renderer: &mut Renderer, poses: &[Pose], camera: &Camera) -> CameraFrame {
    shoot_in(renderer, poses, camera, &Light::beside(camera))
}

fn shoot_in(
    renderer: &mut Renderer,
    poses: &[Pose],
    camera: &Camera,
    light: &Light,
) -> CameraFrame {
    let mut frame = CameraFrame::blank(Intrinsics::from_vertical_fov(1, 1, 1.0));
    renderer.render(poses, camera, light, &mut frame).unwrap();
    frame
}

/// The light of an endoscope with its guide 16 mm beside the lens, which sees more of a shadow.
fn aside(camera: &Camera) -> Light {
    Light {
        guide_in_scene: camera.camera_in_scene * Translation3::new(0.010, -0.012, 0.0),
        ..Light::beside(camera)
    }
}

/// The view ray through a pixel's centre, with unit z, in the camera frame.
fn ray(lens: &Intrinsics, pixel: usize) -> Vector3<f64> {
    let (column, row) = (pixel % lens.width as usize, pixel / lens.width as usize);
    Vector3::new(
        (column as f64 + 0.5 - lens.cx) / lens.fx,
        (row as f64 + 0.5 - lens.cy) / lens.fy,
        1.0,
    )
}

/// Pixels of one id among pixels of the same id: no edge colours them.
fn within(frame: &CameraFrame, id: u8) -> Vec<usize> {
    let width = frame.intrinsics.width as usize;
    let around = [
        0,
        1,
        2,
        width,
        width + 1,
        width + 2,
        2 * width,
        2 * width + 1,
        2 * width + 2,
    ];
    let last = frame.instance.len() - 2 * width - 2;
    (0..last)
        .filter(|first| first % width < width - 2)
        .filter(|first| around.iter().all(|step| frame.instance[first + step] == id))
        .map(|first| first + width + 1)
        .collect()
}

/// Where a point of the scene falls in the image, pixels.
fn project(camera: &Camera, point: Point3<f64>) -> (f64, f64) {
    let p = camera.camera_in_scene.inverse() * point;
    let lens = &camera.intrinsics;
    (lens.fx * p.x / p.z + lens.cx, lens.fy * p.y / p.z + lens.cy)
}

/// Organ patch, half-circle needle and a bent instrument: what a needle lift looks like.
fn lift_scene() -> (Vec<Visual>, Vec<Pose>) {
    let bumps = |x: f64, y: f64| {
        0.0030 * (55.0 * x + 0.4).sin() * (48.0 * y - 0.2).cos()
            + 0.0015 * (150.0 * y + 60.0 * x).sin()
            - 0.0035
    };
    let needle = tube(&arc(0.0095, 0.0, core::f64::consts::PI, 40), &[0.00055], 8);
    let visuals = vec![
        Visual::new(
            "organ",
            height_field(0.08, 0.08, 34, bumps),
            MUSCLE,
            instance::ORGAN,
        ),
        Visual::new("needle", needle, NEEDLE, instance::NEEDLE),
        Visual::new("shaft", shaft(0.15), STEEL, instance::SHAFT),
        Visual::new("wrist", wrist(), STEEL, instance::WRIST),
        Visual::new("left finger", finger(Finger::PlusY), STEEL, instance::JAW),
        Visual::new("right finger", finger(Finger::MinusY), STEEL, instance::JAW),
    ];
    let turn = |x: f64, y: f64, z: f64| Pose::rotation(Vector3::new(x, y, z));
    let shaft_in_scene =
        at(0.024, 0.012, 0.026) * turn(0.0, -2.3, 0.0) * turn(0.0, 0.0, 0.7) * turn(0.5, 0.0, 0.0);
    let wrist_in_scene = shaft_in_scene * turn(0.0, 0.5, 0.0);
    let tip_in_scene = wrist_in_scene * at(0.0, 0.0, hal::psm::WRIST_M) * turn(0.3, 0.0, 0.0);
    let needle_in_scene = at(-0.004, -0.004, 0.003) * turn(0.12, 0.1, 0.4);
    let poses = vec![
        Pose::identity(),
        needle_in_scene,
        shaft_in_scene,
        wrist_in_scene,
        tip_in_scene * turn(-0.35, 0.0, 0.0),
        tip_in_scene * turn(0.35, 0.0, 0.0),
    ];
    (visuals, poses)
}

fn endoscope(size_px: u32) -> Camera {
    let eye = Point3::new(0.035, -0.105, 0.080);
    Camera {
        intrinsics: Intrinsics::from_vertical_fov(size_px, size_px, 0.55),
        camera_in_scene: look_at(eye, Point3::new(0.006, 0.002, 0.006), Vector3::z()),
        near_m: 0.01,
        far_m: 0.5,
        optics: Optics::CLEAN,
    }
}

#[test]
fn depth_of_a_plane_is_the_analytic_one() {
    let plane = Visual::new("plane", height_field(0.5, 0.5, 3, |_, _| 0.0), MUSCLE, 1);
    let mut renderer = Renderer::new(&[plane]).unwrap();
    let camera = tilted_camera();
    let frame = shoot(&mut renderer, &[at(0.0, 0.0, 0.01)], &camera);
    let up = camera.camera_in_scene.rotation.inverse() * Vector3::z();
    let height = camera.camera_in_scene.translation.z - 0.01;
    for (pixel, depth) in frame.depth_m.iter().enumerate() {
        let expected = -height / ray(&camera.intrinsics, pixel).dot(&up);
        assert!(
            (f64::from(*depth) - expected).abs() < 1e-6,
            "pixel {pixel}: {depth} and {expected}"
        );
    }
    assert_eq!(
        (frame.intrinsics, frame.camera_in_scene),
        (camera.intrinsics, camera.camera_in_scene)
    );
}

/// Depth of a ball is the analytic one and nothing is behind it.
#[test]
fn depth_of_a_ball_is_analytic() {
    let radius = 0.02;
    let mut renderer =
        Renderer::new(&[Visual::new("ball", sphere(radius, 128), STEEL, 9)]).unwrap();
    let camera = tilted_camera();
    let centre_in_scene = Point3::new(0.01, 0.005, 0.0);
    let frame = shoot(
        &mut renderer,
        &[centre_in_scene.coords.into()].map(|t: Translation3<f64>| t.into()),
        &camera,
    );
    let centre = (camera.camera_in_scene.inverse() * centre_in_scene).coords;
    let mut hits = 0;
    for pixel in 0..frame.depth_m.len() {
        let ray = ray(&camera.intrinsics, pixel);
        let (along, length2) = (ray.dot(&centre), ray.norm_squared());
        let miss = (centre.norm_squared() - along * along / length2).sqrt() / radius;
        if miss < 0.95 {
            let root = (along * along - length2 * (centre.norm_squared() - radius * radius)).sqrt();
            let expected = (along - root) / length2;
            assert!((f64::from(frame.depth_m[pixel]) - expected).abs() < 1e-4);
            assert_eq!(frame.instance[pixel], 9);
            hits += 1;
        } else if miss > 1.001 {
            assert_eq!(
                (frame.depth_m[pixel].to_bits(), frame.instance[pixel]),
                (0, 0)
            );
        }
    }
    assert!(hits > 300, "{hits}");
}

#[test]
fn the_mask_of_a_box_is_exact() {
    let lens = Intrinsics {
        width: 64,
        height: 48,
        fx: 100.0,
        fy: 110.0,
        cx: 30.0,
        cy: 25.0,
        distortion: Distortion::NONE,
    };
    let camera = Camera {
        intrinsics: lens,
        camera_in_scene: Pose::identity(),
        near_m: 0.01,
        far_m: 1.0,
        optics: Optics::CLEAN,
    };
    let block = Visual::new(
        "box",
        cuboid(Vector3::new(0.0123, 0.0077, 0.001)),
        STEEL,
        200,
    );
    let mut renderer = Renderer::new(&[block]).unwrap();
    // The front face lies at z = 0.1 and hides the rest.
    let centre = Vector3::new(0.005, -0.002, 0.101);
    let frame = shoot(&mut renderer, &[at(centre.x, centre.y, centre.z)], &camera);
    for pixel in 0..lens.pixel_count() {
        let point = 0.1 * ray(&lens, pixel);
        let inside = (point.x - centre.x).abs() < 0.0123 && (point.y - centre.y).abs() < 0.0077;
        assert_eq!(
            frame.instance[pixel],
            if inside { 200 } else { 0 },
            "pixel {pixel}"
        );
    }
}

#[test]
fn points_of_the_scene_fall_where_the_intrinsics_say() {
    let camera = tilted_camera();
    let points = [
        [0.0, 0.0, 0.0],
        [0.02, -0.015, 0.01],
        [-0.03, 0.01, 0.02],
        [0.01, 0.03, -0.01],
    ]
    .map(Point3::from);
    let balls: Vec<_> = (11..15)
        .map(|id| Visual::new("ball", sphere(0.003, 20), STEEL, id))
        .collect();
    let poses = points.map(|p| at(p.x, p.y, p.z));
    let frame = shoot(&mut Renderer::new(&balls).unwrap(), &poses, &camera);
    for (id, point) in (11..15).zip(points) {
        let hits: Vec<usize> = (0..frame.instance.len())
            .filter(|&pixel| frame.instance[pixel] == id)
            .collect();
        assert!(hits.len() > 4, "{} pixels of {id}", hits.len());
        let mean = |f: fn(usize, usize) -> usize| {
            hits.iter()
                .map(|&pixel| f(pixel, 84) as f64 + 0.5)
                .sum::<f64>()
                / hits.len() as f64
        };
        let (x, y) = project(&camera, point);
        assert!((mean(|pixel, width| pixel % width) - x).abs() < 0.5, "{id}");
        assert!((mean(|pixel, width| pixel / width) - y).abs() < 0.5, "{id}");
    }
}

#[test]
fn the_same_scene_gives_the_same_bytes() {
    let (visuals, poses) = lift_scene();
    let camera = endoscope(200);
    let mut first = Renderer::new(&visuals).unwrap();
    let before = shoot(&mut first, &poses, &camera);
    shoot(&mut first, &poses, &tilted_camera());
    let mut second = Renderer::new(&visuals).unwrap();
    for after in [
        shoot(&mut first, &poses, &camera),
        shoot(&mut second, &poses, &camera),
    ] {
        assert!(before.colour == after.colour && before.instance == after.instance);
        assert!(
            before
                .depth_m
                .iter()
                .zip(&after.depth_m)
                .all(|(a, b)| a.to_bits() == b.to_bits())
        );
    }
}

#[test]
fn a_ball_puts_what_is_behind_it_into_shadow() {
    let plane = Visual::new(
        "plane",
        height_field(0.1, 0.1, 3, |_, _| 0.0),
        Material {
            detail: 0.0,
            pattern: Pattern::Smooth,
            ..MUSCLE
        },
        1,
    );
    let ball = Visual::new("ball", sphere(0.006, 32), STEEL, 2);
    let poses = [Pose::identity(), at(0.0, 0.0, 0.025)];
    let camera = Camera {
        camera_in_scene: look_at(Point3::new(0.0, 0.0, 0.12), Point3::origin(), Vector3::y()),
        ..endoscope(128)
    };
    let lamp = aside(&camera);
    let bare = shoot_in(
        &mut Renderer::new(core::slice::from_ref(&plane)).unwrap(),
        &poses[..1],
        &camera,
        &lamp,
    );
    let mut both = Renderer::new(&[plane, ball]).unwrap();
    let shadowed = shoot_in(&mut both, &poses, &camera, &lamp);
    let guide_in_scene = lamp.guide_in_scene;
    let light = (camera.camera_in_scene.inverse() * guide_in_scene) * Point3::origin();
    let ball_centre = camera.camera_in_scene.inverse() * Point3::new(0.0, 0.0, 0.025);
    let red = |frame: &CameraFrame, pixel: usize| f64::from(frame.colour[3 * pixel]);
    let (mut dark, mut bright) = (0, 0);
    for pixel in within(&shadowed, 1) {
        let point =
            Point3::from(ray(&camera.intrinsics, pixel) * f64::from(shadowed.depth_m[pixel]));
        let to_point = (point - light).normalize();
        let miss = (ball_centre - light).cross(&to_point).norm();
        let ratio = red(&shadowed, pixel) / red(&bare, pixel);
        if miss < 0.005 {
            assert!(ratio < 0.8, "pixel {pixel}: {ratio}");
            dark += 1;
        } else if miss > 0.007 {
            assert!(ratio > 0.995, "pixel {pixel}: {ratio}");
            bright += 1;
        }
    }
    assert!(dark > 50 && bright > 5000, "{dark} {bright}");
}

#[test]
fn what_can_not_be_drawn_is_refused() {
    let good = || Visual::new("box", cuboid(Vector3::new(0.01, 0.01, 0.01)), STEEL, 1);
    let mut renderer = Renderer::new(&[good()]).unwrap();
    let mut frame = CameraFrame::blank(endoscope(8).intrinsics);
    let mut attempt = |poses: &[Pose], camera: &Camera, light: &Light| {
        renderer
            .render(poses, camera, light, &mut frame)
            .map_err(|error| error.to_string())
    };
    let (camera, light, pose) = (endoscope(8), Light::default(), [Pose::identity()]);
    for size in [0, 1 << 20] {
        let lens = Intrinsics {
            width: size,
            ..camera.intrinsics
        };
        let refusal = attempt(
            &pose,
            &Camera {
                intrinsics: lens,
                ..camera
            },
            &light,
        )
        .unwrap_err();
        assert!(refusal.contains(&format!("{size} x 8 pixels")), "{refusal}");
    }
    let backwards = Camera {
        near_m: 0.6,
        ..camera
    };
    assert!(
        attempt(&pose, &backwards, &light)
            .unwrap_err()
            .contains("near_m < far_m")
    );
    let flood = Light {
        cone_half_angle_rad: 1.6,
        ..light
    };
    assert!(
        attempt(&pose, &camera, &flood)
            .unwrap_err()
            .starts_with("light")
    );
    assert_eq!(
        attempt(&[], &camera, &light).unwrap_err(),
        "0 poses for 1 visuals"
    );
    assert_eq!(attempt(&pose, &camera, &light), Ok(()));

    let mut broken = good();
    broken.mesh.indices[4] = 1000;
    let refusal = Renderer::new(&[broken]).err().unwrap().to_string();
    assert_eq!(refusal, "mesh of box: an index points past the last vertex");
}

#[test]
fn an_empty_scene_is_background() {
    let mut renderer = Renderer::new(&[]).unwrap();
    let frame = shoot(&mut renderer, &[], &endoscope(16));
    assert!(
        frame.depth_m.iter().all(|depth| depth.to_bits() == 0)
            && frame.instance.iter().all(|id| *id == 0)
    );
    // No void, and not blown out.
    let sum: f64 = frame.colour.iter().map(|byte| f64::from(*byte)).sum();
    let mean = sum / frame.colour.len() as f64;
    assert!((5.0..180.0).contains(&mean), "{mean}");
    assert!(!renderer.adapter_name().is_empty());
}

/// With `TROCAR_RENDER_SAMPLE=FILE.ppm` the picture is kept for a person to look at.
#[test]
fn a_needle_lift_shows_all_of_its_parts() {
    let (visuals, poses) = lift_scene();
    let triangles: usize = visuals
        .iter()
        .map(|visual| visual.mesh.indices.len() / 3)
        .sum();
    assert!((2_000..=5_000).contains(&triangles), "{triangles}");
    let mut renderer = Renderer::new(&visuals).unwrap();
    let frame = shoot(&mut renderer, &poses, &endoscope(512));
    let parts = [
        (instance::ORGAN, 60_000),
        (instance::NEEDLE, 1_000),
        (instance::SHAFT, 2_000),
        (instance::JAW, 1_000),
    ];
    for (id, least) in parts {
        let pixels = frame.instance.iter().filter(|&&seen| seen == id).count();
        assert!(pixels > least, "{pixels} pixels of instance {id}");
    }
    if let Some(path) = std::env::var_os("TROCAR_RENDER_SAMPLE") {
        let mut picture = b"P6 512 512 255\n".to_vec();
        picture.extend(&frame.colour);
        std::fs::write(path, picture).unwrap();
    }
}

#[test]
fn a_reshaped_mesh_is_drawn_where_it_went() {
    let board =
        |x: f64| crate::shapes::placed(cuboid(Vector3::new(0.01, 0.01, 0.002)), &at(x, 0.0, 0.0));
    let visuals = [
        Visual::new("still", board(-0.03), STEEL, 1),
        Visual::new("bent", board(0.0), STEEL, 2),
    ];
    let mut renderer = Renderer::new(&visuals).unwrap();
    let poses = [Pose::identity(); 2];
    let camera = tilted_camera();
    let before = shoot(&mut renderer, &poses, &camera);
    renderer.reshape(1, &board(0.02)).unwrap();
    let after = shoot(&mut renderer, &poses, &camera);
    // As if it had been made there.
    let mut moved = Renderer::new(&[
        visuals[0].clone(),
        Visual::new("bent", board(0.02), STEEL, 2),
    ])
    .unwrap();
    let expected = shoot(&mut moved, &poses, &camera);
    assert!(before.instance.contains(&2) && before.instance != after.instance);
    assert_eq!(after.instance, expected.instance);
    assert_eq!(after.depth_m, expected.depth_m);
    let fewer = renderer
        .reshape(1, &Mesh::default())
        .unwrap_err()
        .to_string();
    assert!(
        fewer.contains("bent") && fewer.contains("as many vertices"),
        "{fewer}"
    );
    assert!(renderer.reshape(2, &board(0.0)).is_err());
}
