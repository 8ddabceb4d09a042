//! Stages as other programs write them come out where they say, and hostile ones get an answer.

use flate2::Crc;
use hal::random::SplitMix64;
use nalgebra::Point3;

use super::of_usd;
use crate::assets::part::Part;

/// A tetrahedron of 1 along the axes, its faces outwards.
const TETRAHEDRON: &str = "int[] faceVertexCounts = [3, 3, 3, 3]
    int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]";

/// A stage in metres with z upwards, which is the scan's world.
fn stage(prims: &str) -> String {
    format!("#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = \"Z\"\n)\n\n{prims}\n")
}

/// A mesh of the tetrahedron with these properties.
fn mesh(properties: &str) -> String {
    format!("def Mesh \"Liver\"\n{{\n    {TETRAHEDRON}\n{properties}\n}}\n")
}

fn parts(text: &str) -> Vec<Part> {
    of_usd(text.as_bytes()).unwrap_or_else(|reason| panic!("{reason}\n{text}"))
}

fn refusal(text: &str) -> String {
    of_usd(text.as_bytes()).expect_err("refused")
}

/// Six times the volume that a mesh's faces are around; below zero if they look inwards.
fn volume(part: &Part) -> f32 {
    let at = |index: u32| Point3::from(part.mesh.positions[index as usize]).coords;
    let (triangles, _) = part.mesh.indices.as_chunks::<3>();
    let of = |[a, b, c]: &[u32; 3]| at(*a).dot(&at(*b).cross(&at(*c)));
    triangles.iter().map(of).sum()
}

/// Where the ends of the axes come to lie.
fn axes(part: &Part) -> [[f32; 3]; 4] {
    part.mesh.positions[..]
        .try_into()
        .expect("the tetrahedron's vertices, in their order")
}

fn near(found: [f32; 3], wanted: [f32; 3]) {
    let apart = (0..3).map(|k| (found[k] - wanted[k]).abs());
    assert!(
        apart.fold(0.0, f32::max) < 1e-5,
        "{found:?}, not {wanted:?}"
    );
}

#[test]
fn meshes_lie_where_their_operations_say() {
    // What each does to the ends of x and of y.
    for (operations, x, y) in [
        (
            "double3 xformOp:translate = (1, 2, 3)
             uniform token[] xformOpOrder = [\"xformOp:translate\"]",
            [2.0, 2.0, 3.0],
            [1.0, 3.0, 3.0],
        ),
        (
            // Scaled first, then turned, then moved.
            "float3 xformOp:scale = (2, 3, 4)
             float xformOp:rotateZ = 90
             float3 xformOp:translate = (0, 0, 5)
             uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:rotateZ\", \"xformOp:scale\"]",
            [0.0, 2.0, 5.0],
            [-3.0, 0.0, 5.0],
        ),
        (
            "float3 xformOp:rotateXYZ = (90, 0, 90)
             uniform token[] xformOpOrder = [\"xformOp:rotateXYZ\"]",
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
        ),
        (
            "float3 xformOp:rotateZYX = (90, 0, 90)
             uniform token[] xformOpOrder = [\"xformOp:rotateZYX\"]",
            [0.0, 0.0, 1.0],
            [-1.0, 0.0, 0.0],
        ),
        (
            // About (1, 0, 0), as Maya writes pivots.
            "float3 xformOp:translate:pivot = (1, 0, 0)
             float xformOp:rotateZ:turn = 180
             uniform token[] xformOpOrder = [\"xformOp:translate:pivot\", \"xformOp:rotateZ:turn\", \"!invert!xformOp:translate:pivot\"]",
            [1.0, 0.0, 0.0],
            [2.0, -1.0, 0.0],
        ),
        (
            "quatf xformOp:orient = (0.70710677, 0, 0, 0.70710677)
             uniform token[] xformOpOrder = [\"xformOp:orient\"]",
            [0.0, 1.0, 0.0],
            [-1.0, 0.0, 0.0],
        ),
        (
            // Rows: what x becomes, what y becomes, what z becomes, where it is.
            "matrix4d xformOp:transform = ( (0, 2, 0, 0), (0, 0, 2, 0), (2, 0, 0, 0), (1, 1, 1, 1) )
             uniform token[] xformOpOrder = [\"xformOp:transform\"]",
            [1.0, 3.0, 1.0],
            [1.0, 1.0, 3.0],
        ),
        (
            // An operation that is not in the order does nothing.
            "double xformOp:translateX = 2
             double3 xformOp:translate = (9, 9, 9)
             uniform token[] xformOpOrder = [\"xformOp:translateX\"]",
            [3.0, 0.0, 0.0],
            [2.0, 1.0, 0.0],
        ),
    ] {
        let found = parts(&stage(&mesh(operations)));
        near(axes(&found[0])[1], x);
        near(axes(&found[0])[2], y);
        // The same in the parent of a mesh that is moved itself.
        let own = "double3 xformOp:translate = (1, 0, 0)\nuniform token[] xformOpOrder = [\"xformOp:translate\"]";
        let inner = format!("def Xform \"Body\" {{\n{operations}\n{}}}", mesh(own));
        let found = parts(&stage(&inner));
        near(axes(&found[0])[0], x);
        // And not where the stack begins anew.
        let anew = own.replace("= [", "= [\"!resetXformStack!\", ");
        let inner = format!("def Xform \"Body\" {{\n{operations}\n{}}}", mesh(&anew));
        near(axes(&parts(&stage(&inner))[0])[0], [1.0, 0.0, 0.0]);
    }
}

#[test]
fn units_and_up_axis_are_the_stages() {
    let [mesh, none] = [mesh(""), String::new()];
    for (heading, x, z) in [
        // OpenUSD takes centimetres and y upwards where a file says nothing.
        (none.as_str(), [-0.01, 0.0, 0.0], [0.0, 0.01, 0.0]),
        (
            "( upAxis = \"Y\" metersPerUnit = 0.1 )",
            [-0.1, 0.0, 0.0],
            [0.0, 0.1, 0.0],
        ),
        (
            "( \"of others\" doc = \"\"\"a # \"b\" \"\"\"; metersPerUnit = 0.001, upAxis = \"Z\" )",
            [0.001, 0.0, 0.0],
            [0.0, 0.0, 0.001],
        ),
    ] {
        let found = parts(&format!("#usda 1.0\n{heading}\n{mesh}"));
        near(axes(&found[0])[1], x);
        near(axes(&found[0])[3], z);
        assert!(volume(&found[0]) > 0.0, "{heading}");
    }
}

#[test]
fn faces_look_outwards_however_they_are_wound() {
    let mirrored =
        "float3 xformOp:scale = (-1, 1, 1)\nuniform token[] xformOpOrder = [\"xformOp:scale\"]";
    let left = "uniform token orientation = \"leftHanded\"";
    assert!(volume(&parts(&stage(&mesh(mirrored)))[0]) > 0.9);
    assert!(volume(&parts(&stage(&mesh(left)))[0]) < -0.9);
    let both = format!("{left}\n{mirrored}");
    assert!(volume(&parts(&stage(&mesh(&both)))[0]) < -0.9);
    // A cube of four quads, and a pentagon and a triangle for two more of its sides' corners.
    let cube = "def Mesh \"small bowel_A\" {
        int[] faceVertexCounts = [4, 4, 4, 4, 5, 4]
        int[] faceVertexIndices = [0, 3, 2, 1, 4, 5, 6, 7, 0, 1, 5, 4, 1, 2, 6, 5, 2, 3, 8, 7, 6, 0, 4, 7, 3]
        double3[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1), (0, 1, 0.5)]
    }";
    let found = parts(&stage(cube));
    assert_eq!(found[0].name, "small-bowel-a");
    assert_eq!(found[0].mesh.indices.len(), 3 * 13);
    assert!((volume(&found[0]) - 6.0).abs() < 1e-5);
}

#[test]
fn colours_are_the_bound_surfaces_or_those_that_are_displayed() {
    let material = |inputs: &str| {
        format!(
            "def Scope \"Looks\" {{ def Material \"Red\" {{
                token outputs:surface.connect = </Looks/Red/Shader.outputs:surface>
                def Shader \"Shader\" {{
                    uniform token info:id = \"UsdPreviewSurface\"
                    {inputs}
                    token outputs:surface
                }}
            }} }}\n"
        )
    };
    let shown =
        "color3f[] primvars:displayColor = [(0, 1, 0), (0, 0, 1)] ( interpolation = \"uniform\" )";
    let bound =
        "rel material:binding = </Looks/Red> ( bindMaterialAs = \"weakerThanDescendants\" )";
    let red = material(
        "color3f inputs:diffuseColor = (1, 0, 0.5)\nfloat inputs:roughness = 0.25\nfloat inputs:clearcoat = 0.75",
    );
    let look = |text: &str| {
        let part = &parts(&stage(text))[0];
        (part.colour, part.roughness, part.wetness)
    };
    assert_eq!(look(&mesh("")), ([1.0; 3], 1.0, 0.5));
    assert_eq!(look(&mesh(shown)), ([0.0, 0.5, 0.5], 1.0, 0.5));
    let own = format!("{}{red}", mesh(&format!("{shown}\n{bound}")));
    assert_eq!(look(&own), ([1.0, 0.0, 0.5], 0.25, 0.75));
    // Bound above it, or to a part of its faces.
    let above = format!("{red}def Xform \"All\" {{ {bound}\n{} }}", mesh(shown));
    assert_eq!(look(&above), ([1.0, 0.0, 0.5], 0.25, 0.75));
    let subset = format!("def GeomSubset \"Front\" {{ {bound} }}");
    let part = look(&format!("{red}{}", mesh(&subset)));
    assert_eq!(part, ([1.0, 0.0, 0.5], 0.25, 0.75));
    // A picture is not read, nor is a material that is not there.
    let picture =
        material("color3f inputs:diffuseColor.connect = </Looks/Red/Picture.outputs:rgb>");
    let both = mesh(&format!("{shown}\n{bound}"));
    assert_eq!(
        look(&format!("{picture}{both}")),
        ([0.0, 0.5, 0.5], 0.5, 0.5)
    );
    assert_eq!(look(&both), ([0.0, 0.5, 0.5], 1.0, 0.5));
}

#[test]
fn what_is_not_seen_is_no_part() {
    let hidden = |name: &str, before: &str, inside: &str| {
        format!(
            "def Xform \"{name}\" {before} {{ {inside}\n{} }}\n",
            mesh("")
        )
    };
    let text = [
        hidden("A", "", "token visibility = \"invisible\""),
        hidden("B", "", "uniform token purpose = \"guide\""),
        hidden("C", "( active = false )", ""),
        hidden("D", "", "").replace("def Xform", "over"),
        hidden("E", "", "").replace("def Xform", "class"),
    ];
    let none = refusal(&stage(&text.concat()));
    assert!(none.contains("it has 0 meshes"), "{none}");
    let shown = hidden(
        "F",
        "",
        "token visibility = \"inherited\"\nuniform token purpose = \"render\"",
    );
    let twice = format!(
        "{}{shown}def Sphere \"Ball\" {{ double radius = 1 }}\n{}",
        text.concat(),
        mesh("")
    );
    let found = parts(&stage(&twice));
    let names: Vec<&str> = found.iter().map(|part| part.name.as_str()).collect();
    assert_eq!(names, ["liver", "liver-2"]);
}

#[test]
fn what_is_not_read_is_refused_with_line_and_prim() {
    let inside = |inside: &str| stage(&format!("def Xform \"Body\"\n{{\n{}}}", mesh(inside)));
    let heading = |heading: &str| stage(&format!("def Xform \"Body\" (\n{heading}\n)\n{{\n}}"));
    for (text, reason) in [
        (
            heading("prepend references = @organs.usda@</Liver>"),
            "line 8, /Body: references is not read",
        ),
        (
            heading("payload = @organs.usda@"),
            "line 8, /Body: payload is not read",
        ),
        (
            heading("variants = {\nstring size = \"small\"\n}"),
            "line 8, /Body: variants is not read",
        ),
        (
            heading("append inherits = </_Organ>"),
            "/Body: inherits is not read",
        ),
        (
            inside("variantSet \"size\" = {}"),
            "line 14, /Body/Liver: variantSet is not read: `usdcat",
        ),
        (
            inside("point3f[] points.timeSamples = { 0: [(0, 0, 0)] }"),
            "points moves with time",
        ),
        (
            inside("int[] primvars:skel:jointIndices = [0]"),
            "/Body/Liver: it has a skin",
        ),
        (
            stage("def PointInstancer \"Many\" {}"),
            "line 7, /Many: a PointInstancer is not read",
        ),
        (
            stage("").replace("upAxis = \"Z\"", "subLayers = [@a.usda@]"),
            "line 4, /: subLayers",
        ),
        (
            stage("").replace("\"Z\"", "\"X\""),
            "upAxis is neither Y nor Z",
        ),
        (
            stage("").replace("Unit = 1", "Unit = 0"),
            "metersPerUnit = 0 is outside",
        ),
        (
            inside("token[] xformOpOrder = [\"xformOp:scale\"]"),
            "/Body/Liver: xformOpOrder has xformOp:scale, which has no value",
        ),
        (
            inside("float3 xformOp:shear = (1, 2, 3)\ntoken[] xformOpOrder = [\"xformOp:shear\"]"),
            "xformOp:shear is no operation",
        ),
        (
            inside("float2 xformOp:scale = (1, 2)\ntoken[] xformOpOrder = [\"xformOp:scale\"]"),
            "xformOp:scale has 2 numbers, not 3",
        ),
    ] {
        let found = refusal(&text);
        assert!(found.contains(reason), "{found}, not {reason}");
    }
}

#[test]
fn hostile_numbers_are_refused_with_line_and_prim() {
    let whole = stage(&mesh(""));
    for (old, new, reason) in [
        (
            "2, 1, 0",
            "2, 9, 0",
            "line 7, /Liver: faceVertexIndices has 9, allowed are whole numbers from 0 to 3",
        ),
        ("2, 1, 0", "2, -1, 0", "has -1, allowed"),
        ("2, 1, 0", "2, 0.5, 0", "has 0.5, allowed"),
        (
            "2, 1, 0",
            "2, 1e300, 0",
            "allowed are whole numbers from 0 to 3",
        ),
        (
            "[3, 3, 3, 3]",
            "[3, 3, 3, 4294967299]",
            "faceVertexCounts has 4294967299",
        ),
        (
            "[3, 3, 3, 3]",
            "[3, 3, 3, 2]",
            "a face of less than 3 corners",
        ),
        (
            "[3, 3, 3, 3]",
            "[3, 3, 3]",
            "more corners than faceVertexCounts says",
        ),
        ("[3, 3, 3, 3]", "[]", "more corners than"),
        (
            "(0, 1, 0)",
            "(0, nan, 0)",
            "line 11, /Liver: points has nan, which is no finite number",
        ),
        ("(0, 1, 0)", "(0, -inf, 0)", "points has -inf"),
        ("(0, 1, 0)", "(0, 1e999, 0)", "points has 1e999"),
        ("(0, 1, 0)", "(0, 1.2.3, 0)", "which is not a number"),
        (
            "(0, 1, 0)",
            "(0, 1)",
            "points has 2 numbers in a bracket, and 3 in another",
        ),
        (
            "(0, 1, 0)",
            "(0, 1e30, 0)",
            "further than 10 m away; the stage has metersPerUnit = 1",
        ),
        ("(0, 1, 0)", "((((0, 1, 0))))", "'(' is not expected here"),
        ("point3f[] points", "point3f[] pints", "it has no points"),
        ("[(0, 0, 0)", "[\"\u{feff}", "has no end"),
        (
            "def Mesh \"Liver\"",
            "def Mesh Liver",
            "line 7, /: Liver is not expected",
        ),
    ] {
        assert!(whole.contains(old), "{old}");
        let found = refusal(&whole.replacen(old, new, 1));
        assert!(found.contains(reason), "{found}, not {reason}");
        assert!(found.starts_with("line "), "{found}");
    }
}

#[test]
fn deep_large_and_foreign_files_are_refused() {
    for (deep, reason) in [
        ("def \"a\" {\n".repeat(100_000), "64 deep"),
        (
            format!("def \"a\" {{ custom string s = {} }}", "[".repeat(100_000)),
            "ends in the middle",
        ),
        ("def \"a\" {}\n".repeat(20_000), "at most 16384 prims"),
        (
            format!("def \"{}\" {{}}", "a".repeat(300)),
            "names of 256 bytes",
        ),
        (mesh("").repeat(70), "more than 64 meshes"),
    ] {
        let found = refusal(&stage(&deep));
        assert!(found.contains(reason), "{found}");
    }
    let mut bytes = stage(&mesh("")).into_bytes();
    bytes[30] = 0xFF;
    let found = of_usd(&bytes).expect_err("no UTF-8");
    assert!(found.contains("line 3: it is no UTF-8"), "{found}");
    let binary = of_usd(b"PXR-USDC\0\0").expect_err("binary");
    assert!(binary.contains("usdcat"), "{binary}");
}

/// A stage with everything that is read.
fn everything() -> String {
    let operations = "double3 xformOp:translate = (0.1, 0.2, 0.3)
        float3 xformOp:rotateXYZ = (10, 20, 30)
        float3 xformOp:scale = (1, 1.5, 2)
        quatf xformOp:orient:more = (0.6, 0, 0.8, 0)
        matrix4d xformOp:transform:last = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0.5, 0, 0, 1))
        uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:rotateXYZ\", \"!invert!xformOp:scale\", \"xformOp:orient:more\", \"xformOp:transform:last\"]";
    let material = "def Material \"Red\" ( customData = { string a = 'b' dictionary c = {} } ) {
        token outputs:surface.connect = </Red/Shader.outputs:surface>
        def Shader \"Shader\" {
            uniform token info:id = \"UsdPreviewSurface\"
            color3f inputs:diffuseColor = (1, 0, 0.5)
        } }";
    let organ = mesh(
        "    rel material:binding = </Red> # bound\n    normal3f[] normals = [(0, 0, 1)] ( interpolation = \"constant\" )",
    );
    stage(&format!(
        "{material}\ndef Xform \"Body\" {{\n{operations}\n{organ}}}"
    ))
}

#[test]
fn whatever_is_cut_or_changed_gets_an_answer() {
    let whole = everything().trim_end().to_owned();
    assert_eq!(parts(&whole).len(), 1);
    for end in (0..whole.len()).filter(|end| whole.is_char_boundary(*end)) {
        assert!(of_usd(&whole.as_bytes()[..end]).is_err(), "{end} bytes");
    }
    let mut random = SplitMix64::new(19);
    let pieces: [&[u8]; 12] = [
        b"(",
        b")",
        b"[",
        b"]",
        b"{",
        b"}",
        b"\"",
        b"-1",
        b"1e308",
        b"nan",
        b"def Mesh \"Liver\" {",
        b"\xff",
    ];
    let (mut read, mut refused) = (0, 0);
    for _ in 0..6000 {
        let mut bytes = whole.clone().into_bytes();
        for _ in 0..1 + random.below(3) {
            let at = random.below(bytes.len());
            let length = random.below(20).min(bytes.len() - at);
            let other = random.below(bytes.len() - length);
            match random.below(4) {
                0 => bytes[at] = u8::try_from(random.below(256)).expect("a byte"),
                1 => drop(bytes.drain(at..at + length)),
                2 => {
                    let copy = bytes[other..other + length].to_vec();
                    drop(bytes.splice(at..at, copy));
                }
                _ => {
                    let piece = pieces[random.below(pieces.len())];
                    drop(bytes.splice(at..at, piece.iter().copied()));
                }
            }
        }
        match of_usd(&bytes) {
            Ok(parts) => {
                read += 1;
                let near = |p: &[f32; 3]| p.iter().all(|x| x.abs() <= 10.0);
                assert!(
                    parts
                        .iter()
                        .all(|part| part.mesh.positions.iter().all(near))
                );
            }
            Err(reason) => {
                refused += 1;
                let is_placed = reason.starts_with("line ") || !reason.contains('/');
                assert!(is_placed || reason.contains("#usda"), "{reason}");
            }
        }
    }
    assert!(
        read > 500 && refused > 2000,
        "{read} read, {refused} refused"
    );
}

/// A package of a file, as archivers write it.
fn package(name: &str, bytes: &[u8]) -> Vec<u8> {
    let mut checksum = Crc::new();
    checksum.update(bytes);
    let size = u32::try_from(bytes.len()).expect("small");
    let length = u16::try_from(name.len()).expect("small");
    let mut file = b"PK\x03\x04\x0a\0\0\0\0\0\0\0\0\0".to_vec();
    for word in [checksum.sum(), size, size] {
        file.extend(word.to_le_bytes());
    }
    file.extend(length.to_le_bytes());
    file.extend(4_u16.to_le_bytes());
    file.extend(name.as_bytes());
    file.extend([0; 4]);
    file.extend(bytes);
    file.extend(b"PK\x05\x06");
    file.extend([0; 18]);
    file
}

#[test]
fn packages_are_their_first_file() {
    let text = stage(&mesh(""));
    let whole = package("stage.usda", text.as_bytes());
    let found = of_usd(&whole).expect("a package");
    assert_eq!(found[0].mesh.positions, parts(&text)[0].mesh.positions);
    for end in 4..whole.len() - 18 {
        assert!(of_usd(&whole[..end]).is_err(), "{end} bytes");
    }
    for (at, byte, reason) in [
        (8, 8, "its first file is compressed or encrypted"),
        (14, 0, "its first file has another checksum"),
        (25, 0x7F, "compressed or encrypted"),
        (26, 0xFF, "ends in the middle"),
        (50, b'!', "checksum"),
    ] {
        let mut bytes = whole.clone();
        assert_ne!(bytes[at], byte, "{at}");
        bytes[at] = byte;
        let found = of_usd(&bytes).expect_err(reason);
        assert!(found.contains(reason), "{found}, not {reason}");
    }
    let both = |byte: u8| {
        let mut bytes = whole.clone();
        bytes[21] = byte;
        bytes[25] = byte;
        of_usd(&bytes).expect_err("too long")
    };
    assert!(both(0xFF).contains("it ends in the middle"));
    let binary = of_usd(&package("a.usdc", b"PXR-USDC\0")).expect_err("binary");
    assert!(binary.contains("usdcat"), "{binary}");
    let picture = of_usd(&package("a.png", b"\x89PNG")).expect_err("a picture");
    assert!(picture.contains("no OpenUSD text"), "{picture}");
}
