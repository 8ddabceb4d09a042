//! A stage as a tree of prims, with the attributes that say where a mesh is and how it looks.

use crate::number::{floor_to, real};

/// How a file comes to do without what is not read.
pub(super) const FLATTEN: &str =
    "`usdcat --flatten FILE -o FLAT.usda` makes one text of all that belongs to it";

/// A stage of one text.
#[derive(Debug)]
pub(super) struct Layer<'a> {
    pub(super) metres_per_unit: f64,
    pub(super) up_axis: &'a str,
    pub(super) prims: Vec<Prim<'a>>,
}

/// A prim.
#[derive(Debug)]
pub(super) struct Prim<'a> {
    pub(super) name: &'a str,
    /// Its type; empty if it has none.
    pub(super) kind: &'a str,
    /// Where it begins.
    pub(super) line: usize,
    /// Whether it is there: defined, and not switched off.
    pub(super) is_active: bool,
    pub(super) attributes: Vec<Attribute<'a>>,
    pub(super) children: Vec<Prim<'a>>,
}

/// An attribute or a relationship with its value.
#[derive(Debug, Default)]
pub(super) struct Attribute<'a> {
    /// With `.connect` if its value is a place.
    pub(super) name: &'a str,
    /// Its numbers, all finite, in one row.
    pub(super) numbers: Vec<f64>,
    /// How many numbers are between two brackets; 0 if there are none.
    pub(super) width: usize,
    /// Its words and places.
    pub(super) words: Vec<&'a str>,
}

impl<'a> Prim<'a> {
    pub(super) fn attribute(&self, name: &str) -> Option<&Attribute<'a>> {
        self.attributes.iter().find(|own| own.name == name)
    }

    /// The first word of an attribute.
    pub(super) fn word(&self, name: &str) -> Option<&'a str> {
        self.attribute(name)?.words.first().copied()
    }

    /// The numbers of an attribute if it is there.
    ///
    /// # Errors
    /// If there are not `N`.
    pub(super) fn numbers<const N: usize>(&self, name: &str) -> Result<Option<[f64; N]>, String> {
        let own = self.attribute(name).filter(|own| !own.numbers.is_empty());
        own.map(Attribute::exactly).transpose()
    }
}

impl Attribute<'_> {
    /// Its numbers.
    ///
    /// # Errors
    /// If there are not `N`.
    pub(super) fn exactly<const N: usize>(&self) -> Result<[f64; N], String> {
        let (name, count) = (self.name, self.numbers.len());
        <[f64; N]>::try_from(self.numbers.as_slice())
            .map_err(|_| format!("{name} has {count} numbers, not {N}"))
    }

    /// Number `at`, which must be whole and from 0 to `most`.
    pub(super) fn whole(&self, at: usize, most: usize) -> Result<usize, String> {
        let value = self.numbers.get(at).copied().unwrap_or(f64::NAN);
        let whole = floor_to(value, most);
        let is_whole = (real(whole) - value).abs() <= 0.0;
        is_whole.then_some(whole).ok_or_else(|| {
            let name = self.name;
            format!("{name} has {value}, allowed are whole numbers from 0 to {most}")
        })
    }
}

impl<'a> Attribute<'a> {
    /// Takes a word of its value.
    pub(super) fn push(&mut self, word: &'a str) -> Result<(), String> {
        let name = self.name;
        match word.parse::<f64>() {
            Ok(number) if number.is_finite() => self.numbers.push(number),
            Ok(_) => return Err(format!("{name} has {word}, which is no finite number")),
            Err(_)
                if word.starts_with(|sign: char| sign.is_ascii_digit() || "+-.".contains(sign)) =>
            {
                return Err(format!("{name} has {word}, which is not a number"));
            }
            Err(_) if word == "None" => {}
            Err(_) => self.words.push(word),
        }
        Ok(())
    }

    /// Takes the numbers from `start` on for those between two brackets.
    pub(super) fn closed(&mut self, start: usize) -> Result<(), String> {
        let (name, found) = (self.name, self.numbers.len() - start);
        if self.width == 0 {
            self.width = found;
        }
        let wanted = self.width;
        let message =
            || format!("{name} has {found} numbers in a bracket, and {wanted} in another");
        (found == wanted).then_some(()).ok_or_else(message)
    }
}

/// What is said in the brackets behind a prim's name, or at the beginning of a file.
#[derive(Default)]
pub(super) struct Heading<'a> {
    pub(super) metres_per_unit: Option<f64>,
    pub(super) up_axis: Option<&'a str>,
    pub(super) is_off: bool,
}

impl<'a> Heading<'a> {
    /// Takes the value of one of its keys.
    pub(super) fn set(&mut self, value: &Attribute<'a>) -> Result<(), String> {
        match value.name {
            "metersPerUnit" => {
                let [metres] = value.exactly()?;
                if !(1e-6..=1e3).contains(&metres) {
                    return Err(format!("metersPerUnit = {metres} is outside [1e-6, 1e3]"));
                }
                self.metres_per_unit = Some(metres);
            }
            "upAxis" => match value.words.first() {
                Some(axis @ (&"Y" | &"Z")) => self.up_axis = Some(axis),
                _ => return Err("upAxis is neither Y nor Z".to_owned()),
            },
            _ => {
                self.is_off = value.words.first() == Some(&"false") || value.numbers == [0.0];
            }
        }
        Ok(())
    }
}
