//! What lenses and sensors do to pictures, against the formulas, and what they leave alone.

use super::super::lens::Window;
use super::*;

const BARREL: Distortion = Distortion::new([-0.9, 0.4, 0.01, -0.015]);

/// All effects at once.
const WORN: Optics = Optics {
    vignette: 0.4,
    exposure: 1.2,
    shot_noise: 0.03,
    read_noise: 0.004,
    smoke_per_m: 3.0,
    blood: 0.6,
    fog: 0.4,
    seed: 11,
    moment: 40,
};

fn distorted(camera: &Camera) -> Camera {
    Camera {
        intrinsics: Intrinsics {
            distortion: BARREL,
            ..camera.intrinsics
        },
        ..*camera
    }
}

/// Ids and depth to the bit.
fn labels(frame: &CameraFrame) -> (&[u8], Vec<u32>) {
    let depth = frame.depth_m.iter().map(|depth| depth.to_bits());
    (&frame.instance, depth.collect())
}

fn mean(frame: &CameraFrame, pixels: impl Iterator<Item = usize>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for pixel in pixels {
        let bytes = &frame.colour[3 * pixel..3 * pixel + 3];
        sum += bytes.iter().map(|byte| f64::from(*byte)).sum::<f64>() / 3.0;
        count += 1.0;
    }
    sum / count
}

/// Light balls on a dark wall: their middles in ids, depth and colour are where the formula has
/// them.
#[test]
fn a_point_falls_where_the_formula_says() {
    let coated = |grey: f32| Material {
        base_colour: [grey; 3],
        metallic: 0.0,
        roughness: 1.0,
        pattern: Pattern::Smooth,
        ..STEEL
    };
    let points = [
        [0.012, 0.016, 0.0],
        [0.04, -0.022, 0.0],
        [-0.035, 0.01, 0.0],
        [0.006, 0.038, 0.0],
    ]
    .map(Point3::from);
    let balls = (11..15).map(|id| Visual::new("ball", sphere(0.002, 16), coated(0.9), id));
    let wall = Visual::new("wall", cuboid(Vector3::new(0.3, 0.3, 1e-3)), coated(0.0), 1);
    let visuals: Vec<_> = balls.chain([wall]).collect();
    let mut poses: Vec<_> = points.iter().map(|p| at(p.x, p.y, p.z)).collect();
    poses.push(at(0.0, 0.0, -0.02));
    let mut camera = tilted_camera();
    camera.intrinsics = Intrinsics {
        width: 252,
        height: 210,
        fx: 285.0,
        fy: 264.0,
        cx: 118.5,
        cy: 108.75,
        // So much of it, and no ray of this wider picture is folded.
        distortion: Distortion::new([-0.5, 0.2, 0.01, -0.015]),
    };
    let mut renderer = Renderer::new(&visuals).unwrap();
    let frame = shoot(&mut renderer, &poses, &camera);
    let mut furthest: f64 = 0.0;
    for (id, point) in (11..15).zip(points) {
        let seen = camera.camera_in_scene.inverse() * point;
        let ray = [seen.x / seen.z, seen.y / seen.z];
        let [u, v] = camera.intrinsics.pixel(ray);
        let [straight_u, straight_v] = camera.intrinsics.pinhole().pixel(ray);
        furthest = furthest.max((u - straight_u).hypot(v - straight_v));
        let place = |pixel: usize| ((pixel % 252) as f64 + 0.5, (pixel / 252) as f64 + 0.5);
        let near = |pixel: &usize| {
            let (x, y) = place(*pixel);
            (x - u).hypot(y - v) < 12.0
        };
        let middle = |weight: &dyn Fn(usize) -> f64| {
            let mut sum = [0.0; 3];
            for pixel in (0..frame.instance.len()).filter(near) {
                let ((x, y), w) = (place(pixel), weight(pixel));
                sum = [sum[0] + w * x, sum[1] + w * y, sum[2] + w];
            }
            assert!(sum[2] > 20.0, "{id}: {}", sum[2]);
            (sum[0] / sum[2], sum[1] / sum[2])
        };
        let of_id = |pixel: usize| f64::from(u8::from(frame.instance[pixel] == id));
        let of_depth = |pixel: usize| {
            let off = f64::from(frame.depth_m[pixel]) - (seen.z - 0.001);
            f64::from(u8::from(off.abs() < 0.001))
        };
        let bright = |pixel: usize| f64::from(u8::from(frame.colour[3 * pixel + 1] > 60));
        for (x, y) in [middle(&of_id), middle(&of_depth), middle(&bright)] {
            assert!(
                (x - u).abs() < 0.5 && (y - v).abs() < 0.5,
                "{id}: {x} {y}, not {u} {v}"
            );
        }
    }
    assert!(furthest > 3.0, "{furthest}");
}

/// Every pixel has id and depth of one pixel of the pinhole, the one on whose ray it lies.
#[test]
fn ids_and_depth_of_a_distorting_lens_are_a_pinholes() {
    let (visuals, poses) = lift_scene();
    let camera = distorted(&endoscope(160));
    let window = Window::of(&camera.intrinsics, 4096).unwrap().intrinsics;
    let pinhole = Camera {
        intrinsics: window,
        ..camera
    };
    let mut renderer = Renderer::new(&visuals).unwrap();
    let light = Light::beside(&camera);
    let mut shoot = |camera: &Camera| {
        let mut frame = CameraFrame::blank(camera.intrinsics);
        renderer.render(&poses, camera, &light, &mut frame).unwrap();
        frame
    };
    let (seen, straight) = (shoot(&camera), shoot(&pinhole));
    assert_eq!(seen.intrinsics, camera.intrinsics);
    let mut compared = 0;
    for pixel in 0..seen.instance.len() {
        let place = [pixel % 160, pixel / 160].map(|it| it as f64 + 0.5);
        let [u, v] = window.pixel(camera.intrinsics.ray(place).unwrap());
        // What single precision can't tell apart is either.
        if [u, v].iter().any(|it| (it - it.round()).abs() < 1e-3) {
            continue;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a pixel"
        )]
        let other = v as usize * window.width as usize + u as usize;
        assert_eq!(seen.instance[pixel], straight.instance[other], "{pixel}");
        let depths = [seen.depth_m[pixel], straight.depth_m[other]].map(f32::to_bits);
        assert_eq!(depths[0], depths[1], "{pixel}");
        compared += 1;
    }
    assert!(compared > 25_000, "{compared}");
}

#[test]
fn optics_change_colours_alone_and_by_their_seed() {
    let (visuals, poses) = lift_scene();
    let mut renderer = Renderer::new(&visuals).unwrap();
    for clean in [endoscope(128), distorted(&endoscope(128))] {
        for shading in [Shading::Full, Shading::Fine] {
            renderer.set_shading(shading);
            let before = shoot(&mut renderer, &poses, &clean);
            let mut seen = |optics| shoot(&mut renderer, &poses, &Camera { optics, ..clean });
            let worn = seen(WORN);
            assert_eq!(labels(&worn), labels(&before));
            assert_ne!(worn.colour, before.colour);
            assert_ne!(seen(Optics { seed: 12, ..WORN }).colour, worn.colour);
            assert_ne!(seen(Optics { moment: 80, ..WORN }).colour, worn.colour);
            assert!(seen(WORN).colour == worn.colour, "the same again");
            let idle = Optics {
                seed: 5,
                moment: 6,
                ..Optics::CLEAN
            };
            assert!(seen(idle).colour == before.colour, "nothing is left of it");
        }
    }
}

#[test]
fn plain_pictures_are_distorted_and_clean() {
    let (visuals, poses) = lift_scene();
    let mut renderer = Renderer::new(&visuals).unwrap();
    renderer.set_shading(Shading::Plain);
    let (straight, bent) = (endoscope(96), distorted(&endoscope(96)));
    let mut seen =
        |camera: &Camera, optics| shoot(&mut renderer, &poses, &Camera { optics, ..*camera });
    let clean = seen(&bent, Optics::CLEAN);
    assert_eq!(seen(&bent, WORN).colour, clean.colour);
    assert_ne!(seen(&straight, WORN).colour, clean.colour);
}

/// Each effect alone does what it is called after.
#[test]
fn effects_do_what_they_say() {
    let grey = Material {
        base_colour: [0.3; 3],
        metallic: 0.0,
        roughness: 1.0,
        pattern: Pattern::Smooth,
        ..STEEL
    };
    let wall = Visual::new("wall", cuboid(Vector3::new(0.3, 0.3, 1e-3)), grey, 1);
    let mut renderer = Renderer::new(&[wall]).unwrap();
    let camera = Camera {
        camera_in_scene: look_at(Point3::new(0.0, 0.0, 0.12), Point3::origin(), Vector3::y()),
        ..endoscope(120)
    };
    let mut seen = |optics| {
        shoot(
            &mut renderer,
            &[Pose::identity()],
            &Camera { optics, ..camera },
        )
    };
    let block =
        |left: usize, top: usize| (0..144).map(move |it| (top + it / 12) * 120 + left + it % 12);
    let (middle, corner) = (|| block(54, 54), || block(0, 0));
    let clean = seen(Optics::CLEAN);
    let of = |change: &dyn Fn(&mut Optics)| {
        let mut optics = Optics {
            seed: 3,
            ..Optics::CLEAN
        };
        change(&mut optics);
        optics
    };
    let dark = seen(of(&|it| it.vignette = 0.5));
    assert!((mean(&dark, middle()) - mean(&clean, middle())).abs() < 2.0);
    // The corner's middle is at 0.81 of the squared distance of the corner itself; light is taken
    // before the sensor's response.
    let (dim, lit) = (mean(&dark, corner()), mean(&clean, corner()));
    let light = |byte: f64| {
        let y = ((byte / 255.0 + 0.055) / 1.055).powf(2.4);
        let half = 0.5 * (0.3833 * y - 0.0593);
        (half + (half * half + 0.1126 * y * (1.0 - y)).sqrt()) / (1.0 - y)
    };
    let left = light(dim) / light(lit);
    assert!((left - (1.0 - 0.5 * 0.81)).abs() < 0.02, "{left}");
    let bright = seen(of(&|it| it.exposure = 1.5));
    let more = light(mean(&bright, corner())) / light(lit);
    assert!((more - 1.5).abs() < 0.05, "{more}");
    let spread = |frame: &CameraFrame| {
        let mean = mean(frame, corner());
        let off = |pixel: usize| (f64::from(frame.colour[3 * pixel]) - mean).powi(2);
        corner().map(off).sum::<f64>() / 144.0
    };
    let noisy = seen(of(&|it| it.shot_noise = 0.05));
    // In the middle the sensor is nearly full, and shows little of it.
    assert!(spread(&noisy) > spread(&clean) + 4.0, "{}", spread(&noisy));
    assert!((mean(&noisy, corner()) - lit).abs() < 3.0);
    let smoky = seen(of(&|it| it.smoke_per_m = 60.0));
    let apart = |frame: &CameraFrame| mean(frame, middle()) - mean(frame, corner());
    assert!(apart(&smoky).abs() < 0.5 * apart(&clean).abs());
    let bloody = seen(of(&|it| it.blood = 1.0));
    let red = |frame: &CameraFrame| {
        let rgb = frame.colour.chunks_exact(3);
        rgb.filter(|rgb| u32::from(rgb[0]) > 3 * u32::from(rgb[1]))
            .count()
    };
    assert!(red(&clean) == 0 && red(&bloody) > 300, "{}", red(&bloody));
}

#[test]
fn lenses_that_can_not_be_are_refused() {
    let mut renderer = Renderer::new(&[]).unwrap();
    let mut refused = |camera: &Camera| {
        let mut frame = CameraFrame::blank(camera.intrinsics);
        let drawn = renderer.render(&[], camera, &Light::default(), &mut frame);
        drawn.unwrap_err().to_string()
    };
    let mut camera = endoscope(32);
    camera.optics.fog = 1.5;
    assert!(refused(&camera).contains("fog must be in [0, 1]"));
    camera = endoscope(32);
    camera.intrinsics.distortion = Distortion::new([-40.0, 0.0, 0.0, 0.0]);
    assert!(refused(&camera).contains("folds rays"));
    camera.intrinsics.distortion.k1 = f64::NAN;
    assert!(refused(&camera).starts_with("camera: the distortion"));
}
