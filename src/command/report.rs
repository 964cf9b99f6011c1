//! How an error is drawn: the problem, the lines of a scene file that it is in, and help.

use annotate_snippets::renderer::DecorStyle;
use annotate_snippets::{AnnotationKind, Element, Group, Level, Renderer, Snippet};
use lobelia::Error;
use lobelia::error::{Fault, SceneDiagnostic};
use std::io::IsTerminal;

/// Columns of a report; longer sentences are wrapped.
const WIDTH: usize = 100;

/// An error as a person reads it on standard error: in colour on a terminal, unless `NO_COLOR` is set.
pub fn report(error: &Error) -> String {
    if let Error::Scene(diagnostic) = error {
        let plain = !std::io::stderr().is_terminal() || std::env::var_os("NO_COLOR").is_some();
        return drawn(diagnostic, if plain { Renderer::plain() } else { Renderer::styled() });
    }
    let mut text = format!("error: {error}\n");
    if let Some(help) = error.help() {
        text += &format!("help: {help}\n");
    }
    text
}

/// A scene's faults one below the other, each with its lines of the file.
fn drawn(diagnostic: &SceneDiagnostic, renderer: Renderer) -> String {
    let renderer = renderer.decor_style(DecorStyle::Unicode).term_width(WIDTH);
    let mut parts = Vec::new();
    if diagnostic.faults.len() > 1 {
        let title = Level::ERROR.primary_title(diagnostic.to_string());
        parts.push(renderer.render(&[Group::with_title(title)]));
    }
    for (i, fault) in diagnostic.faults.iter().enumerate() {
        let note = if i + 1 == diagnostic.faults.len() { diagnostic.note.as_str() } else { "" };
        parts.push(renderer.render(&[group(diagnostic, fault, note)]));
    }
    parts.join("\n\n") + "\n"
}

fn group<'a>(diagnostic: &'a SceneDiagnostic, fault: &'a Fault, note: &'a str) -> Group<'a> {
    let mut kinds =
        std::iter::once(AnnotationKind::Primary).chain(std::iter::repeat(AnnotationKind::Context));
    let labels = fault.labels.iter().map(|label| {
        let kind = kinds.next().unwrap_or(AnnotationKind::Context);
        kind.span(label.at.clone()).label(label.text.as_str())
    });
    let snippet =
        Snippet::source(diagnostic.text.as_str()).path(diagnostic.name.as_str()).annotations(labels);
    let messages = [(Level::HELP, fault.help.as_str()), (Level::NOTE, note)]
        .into_iter()
        .filter(|(_, text)| !text.is_empty())
        .map(|(level, text)| Element::from(level.message(wrapped(text))));
    Level::ERROR.primary_title(fault.message.as_str()).element(snippet).elements(messages)
}

/// The text in lines of at most [`WIDTH`] columns with the margin, broken at blanks.
fn wrapped(text: &str) -> String {
    const MARGIN: usize = 14;
    let mut wrapped = String::new();
    for line in text.lines() {
        let mut column = 0;
        for word in line.split_whitespace() {
            let length = word.chars().count();
            if !wrapped.is_empty() {
                let fits = column > 0 && column + 1 + length <= WIDTH - MARGIN;
                wrapped.push(if fits { ' ' } else { '\n' });
                column = if fits { column + 1 } else { 0 };
            }
            wrapped += word;
            column += length;
        }
    }
    wrapped
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia::error::Label;

    fn diagnostic(faults: Vec<Fault>) -> SceneDiagnostic {
        let text = "Scene(\n    version: 1,\n    seed: -3,\n)\n".to_owned();
        SceneDiagnostic { name: "a.ron".into(), text, faults, note: "As edited.".into() }
    }

    fn fault(word: &str, at: std::ops::Range<usize>) -> Fault {
        let labels = vec![
            Label { at, text: format!("{word} expected") },
            Label { at: 5..6, text: "opened here".into() },
        ];
        Fault { message: format!("{word} is wrong"), labels, help: "Mend it. ".repeat(20) }
    }

    #[test]
    fn a_fault_is_drawn_with_its_lines_and_help() {
        let text = drawn(&diagnostic(vec![fault("seed", 33..35)]), Renderer::plain());
        for words in [
            "error: seed is wrong",
            "a.ron:3:11\n",
            "seed: -3,",
            "seed expected",
            "opened here",
            "As edited.",
        ] {
            assert!(text.contains(words), "no {words:?} in\n{text}");
        }
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert!(!text.contains('\x1b'), "{text}");
        let coloured = drawn(&diagnostic(vec![fault("seed", 33..35)]), Renderer::styled());
        assert!(coloured.contains("\x1b[") && coloured.contains("seed expected"), "{coloured}");
    }

    #[test]
    fn several_faults_have_one_heading_and_one_note() {
        let faults = vec![fault("version", 20..21), fault("seed", 33..35)];
        let text = drawn(&diagnostic(faults), Renderer::plain());
        assert!(text.starts_with("error: 2 problems in a.ron\n"), "{text}");
        assert!(text.contains("a.ron:2:14\n") && text.contains("a.ron:3:11\n"), "{text}");
        assert_eq!(text.matches("As edited.").count(), 1, "{text}");
    }

    #[test]
    fn sentences_are_wrapped_between_words() {
        assert_eq!(wrapped("one two\nthree"), "one two\nthree");
        let long = wrapped(&"twelve chars ".repeat(30));
        assert!(long.lines().count() > 3 && long.lines().all(|line| line.len() <= WIDTH - 14), "{long}");
        assert_eq!(wrapped(&"x".repeat(300)), "x".repeat(300));
    }
}
