//! Which labels of a segmentation make which tissue group, and what a group is like.
//!
//! Two kinds of files: `config/anatomy/groups.toml` says what the groups are, once, and a table
//! says which labels of a segmenter go to which of them. Volumes keep group numbers, 0 for
//! background and the index plus 1 otherwise, in a byte. Labels of `[left_out]` are background on
//! purpose; a label in neither place is an error of whoever reads the volume
//! ([`crate::nifti::read_labels`]), for a new structure must not vanish silently.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use hal::config::{ConfigError, Source};

/// Most groups of a patient: with the background, a set of them fits 32 bits.
const GROUPS_MAX: usize = 31;

/// Tables of labels that are built in: name, path in the repository, text.
///
/// Their text is compiled in, so that a binary needs no folder beside it.
const TABLES: [(&str, &str, &str); 3] = [
    (
        "vista3d",
        "config/anatomy/vista3d.toml",
        include_str!("../../../config/anatomy/vista3d.toml"),
    ),
    (
        "totalsegmentator",
        "config/anatomy/totalsegmentator.toml",
        include_str!("../../../config/anatomy/totalsegmentator.toml"),
    ),
    (
        "groups",
        "config/anatomy/group_numbers.toml",
        include_str!("../../../config/anatomy/group_numbers.toml"),
    ),
];

/// What the surface of a tissue shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pattern {
    /// Lobules, as of a liver.
    Parenchyma,
    /// A thin skin with vessels, as of a bowel.
    Serosa,
    /// Fibres along the body.
    Muscle,
    /// Bone under its periosteum.
    Bone,
    /// Skin, walls of vessels: hardly any.
    Plain,
}

/// A tissue group: one mesh, one material.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Group {
    /// Letters, digits and `-`, as semantics have it; OpenUSD's prims have `_` for `-`.
    pub name: String,
    /// Base colour, linear RGB in [0, 1].
    pub colour: [f64; 3],
    /// What its texture shows.
    pub pattern: Pattern,
    /// Roughness of the surface in [0, 1].
    pub roughness: f64,
    /// Strength of the clear film on it in [0, 1].
    pub wetness: f64,
    /// Mean density, kg/m³.
    pub density_kg_m3: f64,
    /// Young's modulus at small strain, Pa.
    pub youngs_modulus_pa: f64,
    /// Poisson's ratio.
    pub poissons_ratio: f64,
    /// Viscosity over stiffness, s: of a Kelvin-Voigt body, stress is
    /// `E (strain + damping_s * strain rate)`.
    pub damping_s: f64,
    /// How far red light comes before it falls to 1/e, mm; 0 where none is to shine through.
    pub light_mm: f64,
    /// Of two groups that contend for a voxel, the one with the lower rank gets it.
    ///
    /// Different in each group: between equal ranks no voxel would move. The background ranks last.
    pub rank: u32,
}

/// Groups and the labels that make them.
#[derive(Clone, Debug)]
pub struct Groups {
    /// The groups in their order in the assets.
    pub groups: Vec<Group>,
    /// Where the table of labels is from: the path of a file, or the one in the repository of a
    /// table that is built in.
    pub table: String,
    /// The group plus 1 of each label of the table, 0 for the background and what is left out.
    labels: BTreeMap<u16, u8>,
    /// The same for quick look-up: 65536 entries, one for each label there can be.
    quick: Vec<Option<u8>>,
}

/// `groups.toml` as it stands in the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GroupsFile {
    groups: Vec<Group>,
}

/// A table of labels as it stands in a file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TableFile {
    /// Number to name of labels that become background; names are for people.
    #[serde(default)]
    left_out: BTreeMap<String, String>,
    /// Group to its labels, number to name.
    groups: BTreeMap<String, BTreeMap<String, String>>,
}

/// The groups of `groups.toml`, with every value within the range that makes sense.
fn paper_groups() -> Result<Vec<Group>, ConfigError> {
    let text = include_str!("../../../config/anatomy/groups.toml");
    let source = Source::embedded("config/anatomy/groups.toml", text);
    let groups = source.parse::<GroupsFile>()?.groups;
    for (i, group) in groups.iter().enumerate() {
        for value in group
            .colour
            .into_iter()
            .chain([group.roughness, group.wetness])
        {
            source.check_range(&format!("groups.{i}"), value, 0.0, 1.0)?;
        }
        for (key, value, low, high) in [
            ("density_kg_m3", group.density_kg_m3, 1.0, 2e4),
            ("youngs_modulus_pa", group.youngs_modulus_pa, 1.0, 1e12),
            ("poissons_ratio", group.poissons_ratio, 0.0, 0.499),
            ("damping_s", group.damping_s, 0.0, 10.0),
            ("light_mm", group.light_mm, 0.0, 100.0),
        ] {
            source.check_range(&format!("groups.{i}.{key}"), value, low, high)?;
        }
    }
    let count = groups.len().to_string();
    if groups.len() > GROUPS_MAX {
        return Err(source.out_of_range("groups", &count, "[1, 31]"));
    }
    Ok(groups)
}

/// Label numbers of a table's section `key`.
fn numbers<'a>(
    source: &'a Source,
    key: &'a str,
    names: &'a BTreeMap<String, String>,
) -> impl Iterator<Item = Result<u16, ConfigError>> + 'a {
    names.keys().map(move |number| {
        let allowed = "a whole number in [1, 65535]";
        let found = number.parse().ok().filter(|number| *number > 0);
        found.ok_or_else(|| source.out_of_range(&format!("{key}.{number}"), number, allowed))
    })
}

impl Groups {
    /// The paper's 17 groups with the table of labels `table`: `vista3d`, `totalsegmentator`,
    /// `groups`, or a file like these.
    ///
    /// # Errors
    /// [`ConfigError`] naming file, line and key: no such group, a label twice, a label that is not
    /// a number.
    pub fn load(table: &str) -> Result<Self, ConfigError> {
        let built_in = TABLES.iter().find(|(name, ..)| *name == table);
        let (place, source) = match built_in {
            Some((_, path, text)) => (*path, Source::embedded(path, text)),
            None => (table, Source::read(table)?),
        };
        Self::parse(place, &source)
    }

    /// Names of the tables that are built in.
    pub fn tables() -> impl Iterator<Item = &'static str> {
        TABLES.iter().map(|(name, ..)| *name)
    }

    /// `place` is what error messages and reports call the table.
    fn parse(place: &str, source: &Source) -> Result<Self, ConfigError> {
        let groups = paper_groups()?;
        let file: TableFile = source.parse()?;
        let mut labels = BTreeMap::from([(0, 0)]);
        let mut add = |key: &str, label: u16, group: u8| match labels.insert(label, group) {
            None => Ok(()),
            Some(_) => {
                let key = format!("{key}.{label}");
                Err(source.out_of_range(
                    &key,
                    "a label",
                    "those that stand nowhere else in the table",
                ))
            }
        };
        for label in numbers(source, "left_out", &file.left_out) {
            add("left_out", label?, 0)?;
        }
        for (name, members) in &file.groups {
            let key = format!("groups.{name}");
            let found = groups.iter().position(|group| group.name == *name);
            let group = found
                .and_then(|found| u8::try_from(found + 1).ok())
                .ok_or_else(|| {
                    let names: Vec<&str> = groups.iter().map(|group| group.name.as_str()).collect();
                    source.out_of_range(&key, name, &names.join(", "))
                })?;
            for label in numbers(source, &key, members) {
                add(&key, label?, group)?;
            }
        }
        let mut quick = vec![None; 1 << 16];
        for (label, group) in &labels {
            quick[usize::from(*label)] = Some(*group);
        }
        Ok(Self {
            groups,
            table: Path::new(place).display().to_string(),
            labels,
            quick,
        })
    }

    /// The group of `label`: 0 for the background, else its index plus 1; none if the table does
    /// not have it.
    ///
    /// O(1), since it is asked for every voxel. Labels that are left out give `Some(0)`.
    #[must_use]
    pub fn group_of(&self, label: u16) -> Option<u8> {
        self.quick[usize::from(label)]
    }

    /// The index plus 1 of the group called `name`.
    #[must_use]
    pub fn number_of(&self, name: &str) -> Option<u8> {
        let found = self.groups.iter().position(|group| group.name == name)?;
        u8::try_from(found + 1).ok()
    }

    /// Labels that the table has, the background's 0 included.
    pub fn labels(&self) -> impl Iterator<Item = u16> {
        self.labels.keys().copied()
    }

    /// Ranks by group number, the background last.
    ///
    /// One entry more than groups. `clean::separate_touching` is given it.
    #[must_use]
    pub fn ranks(&self) -> Vec<u32> {
        let groups = self.groups.iter().map(|group| group.rank);
        std::iter::once(u32::MAX).chain(groups).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::{Groups, Source};

    #[test]
    fn tables_name_only_groups_that_are() {
        for (table, labels) in [("vista3d", 147), ("totalsegmentator", 119), ("groups", 18)] {
            let groups = Groups::load(table).expect("the table is right");
            assert_eq!(groups.groups.len(), 17);
            assert_eq!(groups.labels().count(), labels, "{table}");
        }
    }

    /// VISTA3D's classes are 132 numbers of which its weights do not support five; the others are
    /// MAISI's.
    #[test]
    fn all_classes_of_vista3d_have_a_place() {
        let vista = Groups::load("vista3d").expect("the table is right");
        let classes = (1..=132).filter(|label| vista.group_of(*label).is_some());
        assert_eq!(classes.count(), 127);
    }

    #[test]
    fn a_group_s_own_number_is_its_place() {
        let groups = Groups::load("groups").expect("the table is right");
        for (label, group) in (1..).zip(&groups.groups) {
            assert_eq!(
                groups.group_of(label),
                groups.number_of(&group.name),
                "{label}"
            );
        }
    }

    #[test]
    fn known_labels_go_where_anatomy_says() {
        let total = Groups::load("totalsegmentator").expect("the table is right");
        let vista = Groups::load("vista3d").expect("the table is right");
        for (groups, label, name) in [
            (&total, 5, "liver"),
            (&total, 52, "vessels"),
            (&total, 27, "spine"),
            (&vista, 1, "liver"),
            (&vista, 6, "vessels"),
            (&vista, 62, "colon"),
            (&vista, 200, "body"),
        ] {
            assert_eq!(groups.group_of(label), groups.number_of(name), "{label}");
        }
        assert_eq!(vista.group_of(120), Some(0));
        assert_eq!(vista.group_of(999), None);
    }

    #[test]
    fn wrong_tables_are_refused_with_line_and_key() {
        for (text, message) in [
            (
                "[groups.liver]\n1 = \"liver\"\n[groups.spleen]\n1 = \"spleen\"",
                "t.toml:4: groups.spleen.1",
            ),
            ("[groups.brain]\n1 = \"brain\"", "t.toml:1: groups.brain"),
            (
                "[groups.liver]\n70000 = \"liver\"",
                "t.toml:2: groups.liver.70000",
            ),
            ("[group.liver]\n1 = \"liver\"", "unknown field"),
        ] {
            let error = Groups::parse("t.toml", &Source::embedded("t.toml", text)).expect_err(text);
            assert!(error.to_string().contains(message), "{error}");
        }
    }
}
