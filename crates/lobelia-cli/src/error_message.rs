//! How an error is drawn: the problem, the lines of a scene file that it is in, and help.

use annotate_snippets::renderer::DecorStyle;
use annotate_snippets::{AnnotationKind, Element, Group, Level, Origin, Renderer, Snippet};
use lobelia::{
    Error, error::Fault, error::SceneDiagnostic, error::stop::StopSignal, error::stop::stopped_by,
};
use std::io::IsTerminal;

/// Columns of a report; longer sentences are wrapped.
const WIDTH: usize = 100;

/// An error as a person reads it on standard error: in color on a terminal, unless `NO_COLOR` is
/// set.
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

/// Faults that are drawn; the rest is counted.
const MOST_FAULTS: usize = 20;

/// Longest line that is drawn, in bytes. No person writes longer ones, and drawing them takes time.
const LONGEST_LINE: usize = 2000;

/// A scene's faults one below the other, each with its lines of the file.
fn drawn(diagnostic: &SceneDiagnostic, renderer: Renderer) -> String {
    let renderer = renderer.decor_style(DecorStyle::Unicode).term_width(WIDTH);
    let mut parts = Vec::new();
    if diagnostic.faults.len() > 1 {
        let title = Level::ERROR.primary_title(diagnostic.to_string());
        parts.push(renderer.render(&[Group::with_title(title)]));
    }
    let shown = diagnostic.faults.len().min(MOST_FAULTS);
    for (i, fault) in diagnostic.faults[..shown].iter().enumerate() {
        let note = if i + 1 == shown { diagnostic.note.as_str() } else { "" };
        parts.push(renderer.render(&[group(diagnostic, fault, note)]));
    }
    if shown < diagnostic.faults.len() {
        parts.push(format!("… and {} more", diagnostic.faults.len() - shown));
    }
    parts.join("\n\n") + "\n"
}

fn group<'a>(diagnostic: &'a SceneDiagnostic, fault: &'a Fault, note: &'a str) -> Group<'a> {
    let SceneDiagnostic { text: whole, name, .. } = diagnostic;
    // The start of the line that holds a byte, and its number.
    let line_of = |at: usize| {
        let start = whole[..at].rfind('\n').map_or(0, |before| before + 1);
        (start, 1 + whole[..start].matches('\n').count())
    };
    // The lines that hold the labels.
    let first = fault.labels.iter().map(|label| label.at.start).min().unwrap_or(0);
    let last = fault.labels.iter().map(|label| label.at.end).max().unwrap_or(0);
    let (start, first_line) = line_of(first);
    let text = &whole[start..whole[last..].find('\n').map_or(whole.len(), |at| last + at)];
    let title = Level::ERROR.primary_title(fault.message.as_str());
    let shown = if text.lines().any(|line| line.len() > LONGEST_LINE) {
        let label = &fault.labels[0];
        let (line_start, line) = line_of(label.at.start);
        let column = 1 + whole[line_start..label.at.start].chars().count();
        let place = Origin::path(name.as_str()).line(line).char_column(column);
        title.element(place).element(Level::NOTE.message(wrapped(&label.text)))
    } else {
        let labels = fault.labels.iter().enumerate().map(|(i, label)| {
            let kind = if i == 0 { AnnotationKind::Primary } else { AnnotationKind::Context };
            kind.span(label.at.start - start..label.at.end - start).label(label.text.as_str())
        });
        let snippet = Snippet::source(text).line_start(first_line).path(name.as_str());
        title.element(snippet.annotations(labels))
    };
    let messages = [(Level::HELP, fault.help.as_str()), (Level::NOTE, note)].into_iter();
    let messages = messages.filter(|(_, text)| !text.is_empty());
    shown.elements(messages.map(|(level, text)| Element::from(level.message(wrapped(text)))))
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

/// The exit code for an error; that of its signal for a run that was stopped.
pub fn exit_code(error: &Error) -> u8 {
    let signal = stopped_by().filter(|_| matches!(error, Error::Interrupted));
    signal.map_or(error.exit_code(), StopSignal::exit_code)
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
        Fault { message: format!("{word} is wrong"), labels, help: "Repair it. ".repeat(20) }
    }

    #[test]
    fn a_fault_is_drawn_with_its_lines_and_help() {
        let text = drawn(&diagnostic(vec![fault("seed", 33..35)]), Renderer::plain());
        let place = ["error: seed is wrong", "a.ron:3:11\n", "seed: -3,"];
        for words in [place, ["seed expected", "opened here", "As edited."]].concat() {
            assert!(text.contains(words), "no {words:?} in\n{text}");
        }
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert!(!text.contains('\x1b'), "{text}");
        let colored = drawn(&diagnostic(vec![fault("seed", 33..35)]), Renderer::styled());
        assert!(colored.contains("\x1b[") && colored.contains("seed expected"), "{colored}");
    }

    #[test]
    fn sentences_are_wrapped_between_words() {
        assert_eq!(wrapped("one two\nthree"), "one two\nthree");
        let long = wrapped(&"twelve chars ".repeat(30));
        assert!(long.lines().count() > 3 && long.lines().all(|line| line.len() <= WIDTH - 14), "{long}");
        assert_eq!(wrapped(&"x".repeat(300)), "x".repeat(300));
    }
}
