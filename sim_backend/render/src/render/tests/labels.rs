//! Ids and depth against rays cast in double precision, and against the ways of shading.

use nalgebra::{Point3, Vector3};

use super::*;

/// All triangles of a scene in the camera frame, with their ids.
fn triangles(visuals: &[Visual], poses: &[Pose], camera: &Camera) -> Vec<([Point3<f64>; 3], u8)> {
    let mut all = Vec::new();
    for (visual, pose) in visuals.iter().zip(poses) {
        let camera_from_object = camera.camera_in_scene.inverse() * pose;
        let at = |index: u32| {
            let position = visual.mesh.positions[index as usize].map(f64::from);
            camera_from_object * Point3::from(position)
        };
        let mesh_triangles = visual.mesh.indices.chunks_exact(3);
        all.extend(mesh_triangles.map(|t| ([at(t[0]), at(t[1]), at(t[2])], visual.instance)));
    }
    all
}

/// The nearest front face along a ray with unit z: its depth and id.
fn nearest(triangles: &[([Point3<f64>; 3], u8)], ray: &Vector3<f64>) -> Option<(f64, u8)> {
    let mut found: Option<(f64, u8)> = None;
    for ([a, b, c], id) in triangles {
        let normal = (b - a).cross(&(c - a));
        let towards = normal.dot(ray);
        if towards >= 0.0 {
            continue;
        }
        let depth = normal.dot(&a.coords) / towards;
        let hit = Point3::from(ray * depth);
        let inside = [(a, b), (b, c), (c, a)]
            .iter()
            .all(|(from, to)| (*to - *from).cross(&(hit - *from)).dot(&normal) >= 0.0);
        if inside && depth > 0.01 && found.is_none_or(|(nearer, _)| depth < nearer) {
            found = Some((depth, *id));
        }
    }
    found
}

#[test]
fn every_pixel_has_the_id_and_depth_of_the_nearest_surface() {
    let (visuals, poses) = lift_scene();
    let camera = endoscope(56);
    let frame = shoot(&mut Renderer::new(&visuals).unwrap(), &poses, &camera);
    let triangles = triangles(&visuals, &poses, &camera);
    let lens = camera.intrinsics;
    let mut clear = 0;
    for pixel in 0..lens.pixel_count() {
        // A hundredth of a pixel around the centre: within that an edge may fall to either side.
        let around = [
            (0.0, 0.0),
            (0.01, 0.0),
            (-0.01, 0.0),
            (0.0, 0.01),
            (0.0, -0.01),
        ];
        let hits = around.map(|(x, y)| {
            let offset = Vector3::new(x / lens.fx, y / lens.fy, 0.0);
            nearest(&triangles, &(ray(&lens, pixel) + offset))
        });
        let ids = hits.map(|hit| hit.map_or(0, |(_, id)| id));
        let got = frame.instance[pixel];
        assert!(ids.contains(&got), "pixel {pixel}: {got} of {ids:?}");
        if ids.iter().all(|id| *id == ids[0]) {
            clear += 1;
            let depths = hits.map(|hit| hit.map_or(0.0, |(depth, _)| depth));
            let [low, high] = [f64::min, f64::max].map(|of| depths.into_iter().fold(depths[0], of));
            let got = f64::from(frame.depth_m[pixel]);
            assert!(
                (low - 1e-6..=high + 1e-6).contains(&got),
                "pixel {pixel}: {got} m, {low} to {high}"
            );
        }
    }
    assert!(clear > 50 * 56, "{clear}");
}

#[test]
fn shading_changes_colours_alone() {
    let (visuals, poses) = lift_scene();
    let mut renderer = Renderer::new(&visuals).unwrap();
    let camera = endoscope(200);
    let full = shoot(&mut renderer, &poses, &camera);
    renderer.set_shading(Shading::Plain);
    let plain = shoot(&mut renderer, &poses, &camera);
    renderer.set_shading(Shading::Fine);
    let fine = shoot(&mut renderer, &poses, &camera);
    renderer.set_shading(Shading::Full);
    let again = shoot(&mut renderer, &poses, &camera);
    let bits = |frame: &CameraFrame| {
        frame
            .depth_m
            .iter()
            .map(|d| d.to_bits())
            .collect::<Vec<_>>()
    };
    for other in [&plain, &fine] {
        assert!(full.instance == other.instance && bits(&full) == bits(other));
        assert!(full.colour != other.colour);
    }
    assert!(full.colour == again.colour);
    renderer.set_shading(Shading::Fine);
    let again = shoot(&mut renderer, &poses, &camera);
    assert!(fine.colour == again.colour);
}

#[test]
fn several_cameras_at_once_see_what_each_sees_alone() {
    let (visuals, poses) = lift_scene();
    let mut renderer = Renderer::new(&visuals).unwrap();
    let light = Light::beside(&endoscope(64));
    let cameras = [endoscope(64), tilted_camera(), endoscope(64), endoscope(40)];
    let blank = || CameraFrame::blank(Intrinsics::from_vertical_fov(1, 1, 1.0));
    let mut together = cameras.map(|_| blank());
    let mut shots: Vec<_> = cameras.into_iter().zip(&mut together).collect();
    renderer.render_all(&poses, &light, &mut shots).unwrap();
    for (camera, seen) in cameras.iter().zip(&together) {
        let mut alone = blank();
        renderer.render(&poses, camera, &light, &mut alone).unwrap();
        assert!(alone.colour == seen.colour && alone.instance == seen.instance);
        assert!(alone.depth_m == seen.depth_m);
        assert_eq!(alone.intrinsics, seen.intrinsics);
    }
    assert_ne!(together[0].colour, together[3].colour);
    assert!(renderer.render_all(&poses, &light, &mut []).is_ok());
}
