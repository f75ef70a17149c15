//! The page that `seepd evaluate --causes --html` leaves.

use std::collections::BTreeSet;

use maud::{Markup, html};

use super::page;
use crate::evaluation::causes::{BASELINE_CYCLES, CauseEvaluation, LOAD_VARIATION, NOISE, PlantedRow};
use crate::quantity::percent;

/// What the page shows.
pub struct CausePage<'a> {
    /// The evaluation.
    pub evaluation: &'a CauseEvaluation,
}

impl CausePage<'_> {
    /// The page's text.
    pub fn render(&self) -> String {
        let CauseEvaluation { machines, watched_cycles, seed, .. } = self.evaluation;
        let tile = |share: f64, what: &str| html! { div { b { (percent(share, 1)) } span { (what) } } };
        let body = html! {
            h1 { "Named causes on simulated machines" }
            p { (machines) " machines of the series (seed " (seed) "): a baseline of " (BASELINE_CYCLES) " healthy cycles, then another day with a change, " (watched_cycles)
                " cycles. Oil, supply and load are ordinary, the load varies by " (100.0 * LOAD_VARIATION) " % from cycle to cycle, the noise of the command is " (NOISE) "." }
            div.tiles {
                (tile(self.evaluation.right, "right, of all machines"))
                (tile(self.evaluation.right_within_class, "right, where causes that look alike count as one"))
                (tile(self.evaluation.flags_without_leak, "of the machines without a leak had a flag"))
                (tile(self.evaluation.conditions_without_change, "of the machines that stayed as they were had a condition"))
            }
            h2 { "Who is taken for whom" }
            p.soft { "Rows are what was planted, columns what the last cycle says; on the diagonal it is right." }
            (self.matrix())
            h2 { "How soon" }
            p.soft { "Cycles from the change until the cause was found over cycles: by its sum, a leak by the CUSUM." }
            (self.delays())
        };
        page("Named causes – seepd", &body)
    }

    fn matrix(&self) -> Markup {
        let rows = &self.evaluation.planted;
        let planted = rows.iter().map(|row| row.cause);
        let others: BTreeSet<&str> = rows
            .iter()
            .flat_map(|row| row.named.keys().copied())
            .filter(|named| rows.iter().all(|row| row.cause != *named))
            .collect();
        let columns: Vec<&str> = planted.chain(others).collect();
        let cell = |row: &PlantedRow, column: &str| row.named.get(column).copied();
        html! {
            div.scroll { table {
                thead { tr { th { "planted" } @for column in &columns { th.number { (column.replace('_', " ")) } } } }
                tbody { @for row in rows { tr {
                    td { (row.cause.replace('_', " ")) }
                    @for column in &columns { td.number {
                        @if let Some(count) = cell(row, column) { @if *column == row.cause { b { (count) } } @else { (count) } }
                    } }
                } } }
            } }
        }
    }

    fn delays(&self) -> Markup {
        let or_dash = |cycles: Option<usize>| cycles.map_or("–".to_owned(), |cycles| cycles.to_string());
        html! {
            div.scroll { table {
                thead { tr { th { "planted" } th.number { "machines" } th.number { "found" } th.number { "median, cycles" } th.number { "slowest, cycles" } } }
                tbody { @for row in self.evaluation.planted.iter().filter(|row| row.cause != "none") { tr {
                    td { (row.cause.replace('_', " ")) }
                    td.number { (row.machines) } td.number { (row.found) }
                    td.number { (or_dash(row.median_cycles)) } td.number { (or_dash(row.slowest_cycles)) }
                } } }
            } }
        }
    }
}
