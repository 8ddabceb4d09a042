//! Where on the sheet everything goes: a block a task, a row a camera, colour, depth and ids beside
//! each other.

use hal::count::{count_u32, index};
use image::{Rgb, RgbImage, imageops};
use trocar_tasks::task;

use super::font;
use super::plates::{Plates, id_colour};

/// Columns of blocks.
const COLUMNS: usize = 2;

/// Pictures in a row.
const PLATES: u32 = 3;

const PAPER: Rgb<u8> = Rgb([24, 24, 27]);
const INK: Rgb<u8> = Rgb([235, 235, 235]);
const LABEL: Rgb<u8> = Rgb([12, 12, 14]);

/// One camera of a task.
pub(super) struct Row {
    /// Its name.
    pub(super) camera: String,
    /// What it saw.
    pub(super) plates: Plates,
}

/// One task.
pub(super) struct Block {
    /// Its name.
    pub(super) title: String,
    /// Its cameras.
    pub(super) rows: Vec<Row>,
    /// The instance ids that some of them see, in order.
    pub(super) ids: Vec<u8>,
}

/// Sizes that follow from the width of a picture, pixels.
#[derive(Clone, Copy)]
struct Sizes {
    plate: u32,
    /// Side of a letter's dot.
    dot: u32,
    gap: u32,
}

impl Sizes {
    const fn new(plate: u32) -> Self {
        let dot = if plate < 256 { 1 } else { plate / 128 };
        Self {
            plate,
            dot,
            gap: 3 * dot,
        }
    }

    const fn block_width(self) -> u32 {
        PLATES * (self.plate + self.gap) + self.gap
    }

    /// Height of a line with the space around it.
    const fn line(self) -> u32 {
        font::height(self.dot) + 2 * self.gap
    }

    fn block_height(self, block: &Block) -> u32 {
        let rows = block.rows.iter();
        let heights = rows.map(|row| row.plates.colour.height() + self.gap);
        self.line() + heights.sum::<u32>() + self.gap
    }
}

/// The whole sheet, with pictures `width` pixels wide.
pub(super) fn compose(blocks: &[Block], width: u32) -> RgbImage {
    let sizes = Sizes::new(width);
    let columns = COLUMNS.min(blocks.len().max(1));
    let mut heights = [0; COLUMNS];
    let mut places = Vec::with_capacity(blocks.len());
    for block in blocks {
        // The next block goes where there is most room.
        let shortest = (0..columns).min_by_key(|&column| heights[column]);
        let column = shortest.unwrap_or(0);
        let left = count_u32(column) * sizes.block_width();
        places.push([left, heights[column]]);
        heights[column] += sizes.block_height(block);
    }
    let total_width = count_u32(columns) * sizes.block_width();
    let body = heights.into_iter().max().unwrap_or(0);
    let legend = legend(blocks, total_width, sizes);
    let mut sheet = RgbImage::from_pixel(total_width, body + legend.height(), PAPER);
    for (block, place) in blocks.iter().zip(places) {
        draw(&mut sheet, block, place, sizes);
    }
    imageops::replace(&mut sheet, &legend, 0, i64::from(body));
    sheet
}

fn draw(sheet: &mut RgbImage, block: &Block, [left, top]: [u32; 2], sizes: Sizes) {
    let heads = [block.title.as_str(), "depth", "ids"];
    let x_of = |plate: u32| left + sizes.gap + plate * (sizes.plate + sizes.gap);
    for (plate, head) in (0..).zip(heads) {
        let place = [x_of(plate), top + sizes.gap];
        font::write(sheet, head, place, sizes.dot, INK);
    }
    let mut y = top + sizes.line();
    for row in &block.rows {
        let plates = &row.plates;
        for (plate, picture) in (0..).zip([&plates.colour, &plates.depth, &plates.ids]) {
            imageops::replace(sheet, picture, i64::from(x_of(plate)), i64::from(y));
        }
        label(sheet, &row.camera, [x_of(0), y], sizes);
        if let Some(range) = &plates.range_mm {
            let text = format!("{} to {} mm", range.start(), range.end());
            label(sheet, &text, [x_of(1), y], sizes);
        }
        y += plates.colour.height() + sizes.gap;
    }
}

/// Writes `text` on a dark strip in the corner of a picture, as much of it as the picture is wide.
fn label(sheet: &mut RgbImage, text: &str, [x, y]: [u32; 2], sizes: Sizes) {
    let letters = sizes.plate.saturating_sub(sizes.gap) / font::width("x", sizes.dot);
    let end = index(letters.into());
    let text = text.get(..end).unwrap_or(text);
    let strip = [
        font::width(text, sizes.dot) + sizes.gap,
        font::height(sizes.dot) + 2 * sizes.dot,
    ];
    font::fill(sheet, [x, y], strip, LABEL);
    let inside = [x + sizes.dot, y + sizes.dot];
    font::write(sheet, text, inside, sizes.dot, INK);
}

/// What the colours of the ids mean, in as many lines as it takes.
fn legend(blocks: &[Block], width: u32, sizes: Sizes) -> RgbImage {
    let seen = |id: u8| blocks.iter().any(|block| block.ids.contains(&id));
    let side = font::height(sizes.dot);
    let mut places = Vec::new();
    let (mut x, mut y) = (sizes.gap, 0);
    for id in (1..=u8::MAX).filter(|&id| seen(id)) {
        let name = name_of(id);
        let wide = side + sizes.gap + font::width(&name, sizes.dot) + 2 * sizes.gap;
        if x + wide > width && x > sizes.gap {
            (x, y) = (sizes.gap, y + sizes.line());
        }
        places.push((id, name, [x, y + sizes.gap]));
        x += wide;
    }
    let mut legend = RgbImage::from_pixel(width, y + sizes.line(), PAPER);
    for (id, name, [x, y]) in places {
        font::fill(&mut legend, [x, y], [side, side], id_colour(id));
        let text = [x + side + sizes.gap, y];
        font::write(&mut legend, &name, text, sizes.dot, INK);
    }
    legend
}

fn name_of(id: u8) -> String {
    let known = task::parts().find(|part| part.instance == id);
    known.map_or_else(|| format!("id {id}"), |part| part.name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::{CameraFrame, Intrinsics};
    use trocar_render::visual::instance;
    use trocar_tasks::task::block_transfer::{BLOCK, PEG};

    fn block(cameras: usize, id: u8) -> Block {
        let mut frame = CameraFrame::blank(Intrinsics::from_vertical_fov(8, 4, 0.9));
        frame.colour.fill(200);
        frame.instance.fill(id);
        frame.depth_m.fill(0.1);
        let row = |_| Row {
            camera: "x".to_owned(),
            plates: Plates::new(&frame, 64),
        };
        Block {
            title: "a-task".to_owned(),
            rows: (0..cameras).map(row).collect(),
            ids: vec![id],
        }
    }

    #[test]
    fn every_picture_is_on_the_sheet_once() {
        let blocks = [block(3, instance::NEEDLE), block(4, BLOCK), block(3, PEG)];
        let sheet = compose(&blocks, 64);
        let count = |colour: Rgb<u8>| sheet.pixels().filter(|pixel| **pixel == colour).count();
        // The legend's square of 7 pixels a side comes on top.
        for (id, cameras) in [(instance::NEEDLE, 3), (BLOCK, 4), (PEG, 3)] {
            assert_eq!(count(id_colour(id)), cameras * 64 * 32 + 49, "{id}");
        }
        let colours = count(Rgb([200; 3]));
        let labels = 10 * 9 * 9;
        assert!(
            (10 * 64 * 32 - labels..=10 * 64 * 32).contains(&colours),
            "{colours}"
        );
        assert_eq!(sheet.width(), 2 * (3 * 67 + 3));
    }

    #[test]
    fn a_long_legend_takes_several_lines_and_loses_nothing() {
        let ids: Vec<u8> = task::parts().map(|part| part.instance).collect();
        let blocks: Vec<Block> = ids.iter().map(|&id| block(1, id)).collect();
        let sizes = Sizes::new(64);
        let drawn = legend(&blocks, 120, sizes);
        assert!(drawn.height() >= 5 * sizes.line());
        for id in ids {
            let found = drawn.pixels().filter(|pixel| **pixel == id_colour(id));
            assert_eq!(found.count(), 49, "{id}");
        }
    }
}
