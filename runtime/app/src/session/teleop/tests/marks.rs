//! What whoever steers says of a run or of a recording: its mark and its label.

use trocar_log::{RunMark, RunNote};

use super::*;

/// A run that no task judges is marked and labelled as often as one likes; its newest mark is told
/// once.
#[test]
fn a_run_is_marked_if_it_asks() {
    let hands = Hands::new();
    let no_mark = Err(HandsMessageError::NoMark);
    assert_eq!(hands.mark(Some(RunMark::Success)), no_mark);
    assert_eq!((hands.said(), hands.take_mark()), (None, None));
    hands.ask_for_mark();
    assert_eq!(hands.said(), Some(RunNote::default()));
    for (mark, news) in [
        (None, None),
        (Some(RunMark::Failure), Some(Some(RunMark::Failure))),
        (Some(RunMark::Failure), None),
        (None, Some(None)),
    ] {
        hands.mark(mark).unwrap();
        assert_eq!(hands.take_mark(), news, "{mark:?}");
    }
    hands.set_label("first try").unwrap();
    // As the buttons of a device at the robot's computer.
    for (wish, expected) in [
        (EpisodeCommand::Keep, Ok(Some(RunMark::Success))),
        (EpisodeCommand::Redo, Err(HandsMessageError::NoRecording)),
        (EpisodeCommand::Discard, Ok(Some(RunMark::Discard))),
        (EpisodeCommand::Start, Err(HandsMessageError::NoRecording)),
    ] {
        let said = hands.wish(wish).map(|()| hands.said().unwrap().mark);
        assert_eq!(said, expected, "{wish:?}");
    }
    let said = hands.said().unwrap();
    assert_eq!(said.to_string(), "marked discard, label \"first try\"");
    assert!(hands.take_label().is_none(), "no demonstration's");
}

/// A label is one line, whoever gives it; one that is none changes nothing.
#[test]
fn a_label_is_one_short_line() {
    let (run, recording) = (Hands::new(), Hands::new());
    run.ask_for_mark();
    recording.tell_recording(Recording {
        phase: Phase::Running,
        kept: 0,
        wanted: 1,
        seed: 3,
    });
    let longest = "ä".repeat(64);
    for (text, label) in [
        (longest.as_str(), longest.as_str()),
        (" third try ", "third try"),
    ] {
        run.say(None, Some(text)).unwrap();
        assert_eq!(run.said().unwrap().label, label);
        run.set_label(text).unwrap();
        assert_eq!(run.said().unwrap().label, label);
        recording.set_label(text).unwrap();
        assert_eq!(recording.take_label().as_deref(), Some(label));
    }
    let too_long = format!("{longest}b");
    for text in [
        too_long.as_str(),
        "two\nlines",
        "\u{7f}",
        "\u{85}",
        "a\u{2028}b",
        "\u{2029}",
    ] {
        let said = run.say(Some(RunMark::Success), Some(text));
        assert_eq!(said, Err(HandsMessageError::Label), "{text:?}");
        for hands in [&run, &recording] {
            let refused = hands.set_label(text);
            assert_eq!(refused, Err(HandsMessageError::Label), "{text:?}");
        }
    }
    let said = run.said().unwrap();
    assert_eq!((said.mark, said.label.as_str()), (None, "third try"));
    assert!(recording.take_label().is_none());
}
