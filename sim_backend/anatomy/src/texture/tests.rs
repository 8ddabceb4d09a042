use super::*;
use crate::atlas::unwrap;
use crate::groups::Groups;

/// A tetrahedron with edges of some 30 mm.
fn tetrahedron() -> GroupMesh {
    let positions: Vec<Point3<f64>> = [
        [0.0, 0.0, 0.0],
        [30.0, 2.0, 1.0],
        [3.0, 28.0, -2.0],
        [9.0, 8.0, 27.0],
    ]
    .map(Point3::from)
    .into();
    let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    let normals = vec![[0.0, 0.0, 1.0]; 4];
    let mut mesh = GroupMesh {
        group: 0,
        positions,
        triangles,
        normals,
        uv: Vec::new(),
    };
    unwrap(&mut mesh);
    mesh
}

fn pixels(png: &[u8]) -> image::RgbImage {
    image::load_from_memory(png).unwrap().to_rgb8()
}

/// A pixel shows the colour of the place of the mesh that has its texture coordinates, on both
/// sides of a seam.
#[test]
fn pixels_have_the_colours_of_their_places() {
    let groups = Groups::load("groups").unwrap();
    let (mesh, side) = (tetrahedron(), 256_u32);
    // How far all are apart, and how far where v is taken for downwards.
    let mut sums = [0, 0];
    for group in &groups.groups {
        let picture = pixels(&png(group, &mesh, side).unwrap());
        let mut apart = 0;
        for triangle in 0..4 {
            let corners = mesh.corners(triangle);
            for shares in [[0.6, 0.2, 0.2], [0.2, 0.7, 0.1], [0.3, 0.3, 0.4]] {
                let place = (0..3)
                    .map(|k| corners[k].coords * shares[k])
                    .sum::<Vector3<f64>>();
                let at = [0, 1].map(|axis| {
                    (0..3)
                        .map(|k| f64::from(mesh.uv[triangle][k][axis]) * shares[k])
                        .sum::<f64>()
                });
                let wanted = encoded(group.pattern.colour(group.colour, &Point3::from(place)));
                let off = |v: f64| {
                    let at = [at[0], v].map(|share| floor_to(share * f64::from(side), 255));
                    let [column, row] = at.map(|pixel| u32::try_from(pixel).unwrap());
                    let seen = picture.get_pixel(column, row);
                    (0..3)
                        .map(|k| i32::from(seen[k].abs_diff(wanted[k])))
                        .fold(0, i32::max)
                };
                let offs = [off(1.0 - at[1]), off(at[1])];
                apart = apart.max(offs[0]);
                sums = [0, 1].map(|way| sums[way] + offs[way]);
            }
        }
        // Half a pixel is less than 0.2 mm.
        assert!(apart < 40, "{}: {apart}", group.name);
    }
    assert!(2 * sums[0] < sums[1], "{sums:?}");
}

/// Patterns keep a group's colour in the mean, differ from place to place, and repeat to the bit.
#[test]
fn patterns_keep_the_colour_of_their_group() {
    let groups = Groups::load("groups").unwrap();
    for group in &groups.groups {
        let places =
            (0..4000_u32).map(|k| Point3::from([1.37, 0.91, 2.03].map(|step| step * f64::from(k))));
        let colours: Vec<[f64; 3]> = places
            .map(|p| group.pattern.colour(group.colour, &p))
            .collect();
        for channel in 0..3 {
            let mean = colours.iter().map(|colour| colour[channel]).sum::<f64>() / 4000.0;
            let off = mean - group.colour[channel];
            assert!(
                off.abs() < 0.12 * group.colour[channel] + 0.01,
                "{}: {mean}",
                group.name
            );
        }
        let reds = || colours.iter().map(|colour| colour[0]);
        let range = reds().fold(0.0, f64::max) - reds().fold(1.0, f64::min);
        assert!(range > 0.04 * group.colour[0], "{}: {range}", group.name);
    }
    let mesh = tetrahedron();
    let twice = [0, 1].map(|_| png(&groups.groups[0], &mesh, 64).unwrap());
    assert_eq!(twice[0], twice[1]);
}

/// Around charts their colours go on: a filter that looks beyond a seam does not find another
/// colour.
#[test]
fn colours_go_on_beyond_charts() {
    let groups = Groups::load("groups").unwrap();
    let mesh = tetrahedron();
    let side = 128;
    let picture = pixels(&png(&groups.groups[0], &mesh, 128).unwrap());
    let inside: Vec<bool> = places(&mesh, side).iter().map(Option::is_some).collect();
    let elsewhere = encoded(groups.groups[0].colour);
    let (mut borders, mut beyond) = (0, 0);
    for row in 0..side {
        for column in 1..side {
            let pair = [inside[row * side + column - 1], inside[row * side + column]];
            if pair == [true, false] {
                let pixel =
                    picture.get_pixel(u32::try_from(column).unwrap(), u32::try_from(row).unwrap());
                borders += 1;
                beyond += u32::from(pixel.0 != elsewhere);
            }
        }
    }
    assert!(
        borders > 50 && 10 * beyond > 9 * borders,
        "{beyond} {borders}"
    );
}
