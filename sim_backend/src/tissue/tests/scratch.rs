use super::*;
use super::grasp::from_above;
#[test]
fn scratch_drag() {
    for (mi, mg) in [(0.6,0.4)] {
    let mut puppet = from_above(0.015, 0.0, 0.003);
    puppet.close(2.0);
    puppet.travel(Vector3::new(0.0, 0.0, -0.003), 0.02);
    puppet.wait(300);
    for _ in 0..8 {
        let f = puppet.tissue.jaw(0); let load=f.pressed_n[0]+f.pressed_n[1];
        println!("{mi} {mg} load {load:.4} total {:?} depth {:.5} ground {:.5}", f.total().force.as_slice(), f.depth_m, puppet.tissue.report().ground_depth_m);
        puppet.travel(Vector3::new(0.001, 0.0, 0.0), 0.02);
    }
    }
}
