//! Self-contained HTML pages: one file, no outside requests, light and dark, readable on paper.

#[cfg(feature = "adopt")]
pub(crate) mod adopt;
#[cfg(feature = "adopt")]
mod catalogue;
#[cfg(feature = "train")]
pub mod cause_evaluation;
pub mod chart;
#[cfg(feature = "simulate")]
pub mod demo;
pub mod evaluation;
pub mod flags;
#[cfg(feature = "gap")]
pub mod gap;
pub mod report;
#[cfg(feature = "study")]
pub mod study;

use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Colours of reports and of the dashboard alike: they follow the reader's light or dark setting, and paper gets the light one. Texts have
/// a contrast of 4.5 at least.
const PALETTE: &str = include_str!("palette.css");
/// Layout of every report. The chart's classes take their colours from the palette.
const STYLE: &str = "
*{box-sizing:border-box}body{margin:0;background:var(--ground);color:var(--text);font:16px/1.5 system-ui,'Segoe UI',Roboto,sans-serif}
main{max-width:62rem;margin:0 auto;padding:2rem 1.25rem 3rem}h1{font-size:1.7rem;line-height:1.25;margin:0 0 .4rem}
h2{font-size:1.15rem;margin:2.2rem 0 .3rem}p{margin:.3rem 0 .8rem;max-width:46rem}.soft{color:var(--soft)}
figure{margin:.6rem 0 0;padding:.6rem .6rem .3rem;background:var(--panel);border:1px solid var(--line);border-radius:8px}
svg{display:block;width:100%;height:auto}svg text{fill:var(--soft);font-size:12px;font-family:inherit}
.grid{stroke:var(--line);stroke-width:1}.axis{stroke:var(--soft);stroke-width:1}.series{fill:none;stroke-width:1.8;stroke-linejoin:round}
.stroke-a{stroke:var(--a)}.stroke-b{stroke:var(--b)}.fill-band{fill:var(--band)}.limit{stroke-dasharray:5 4;stroke-width:1.2}
.dash{stroke-dasharray:7 4}.mark{stroke:var(--line);stroke-width:1.5}.dot-a{fill:var(--a)}.dot-b{fill:var(--b)}
.bars{width:100%}.bars td{padding-right:.6rem}.bar{display:block;height:.8em;border-radius:2px;background:var(--c);min-width:1px;
print-color-adjust:exact;-webkit-print-color-adjust:exact}.bars .grow{width:45%}.bars .narrow{width:14%}.stroke-soft{stroke:var(--soft)}:root{--s0:#9db8dd;--s1:#7fa3d6;--s2:#5b88cf;--s3:#3a6cbf;--s4:#8a3f7c;--s5:#c0283c}
.shade-0{stroke:var(--s0)}.shade-1{stroke:var(--s1)}.shade-2{stroke:var(--s2)}.shade-3{stroke:var(--s3)}.shade-4{stroke:var(--s4)}.shade-5{stroke:var(--s5)}
h3{font-size:1rem;margin:1.2rem 0 .4rem}ol{padding-left:1.3rem;max-width:46rem}figcaption{font-size:.82rem;color:var(--soft);overflow-wrap:anywhere}.grid-2,.grid-3{display:grid;gap:.6rem;grid-template-columns:repeat(2,1fr)}
.grid-3{grid-template-columns:repeat(3,1fr)}.grid-2 figure,.grid-3 figure{margin:0}
.tiles{display:grid;gap:.6rem;grid-template-columns:repeat(3,1fr);margin:1rem 0}
.tiles div{background:var(--panel);border:1px solid var(--line);border-radius:8px;padding:.5rem .8rem}
.tiles b{display:block;font-size:1.25rem;line-height:1.3}.tiles span{font-size:.82rem;color:var(--soft)}
.key{display:flex;flex-wrap:wrap;gap:.2rem 1.2rem;padding:.2rem .4rem .3rem;font-size:.86rem;color:var(--soft)}
.key span::before{content:'';display:inline-block;width:1.4em;height:.25em;margin-right:.45em;vertical-align:middle;background:var(--c)}
.key .wide::before{height:.8em}table{border-collapse:collapse;margin:.6rem 0;font-variant-numeric:tabular-nums;font-size:.95rem}
th,td{text-align:left;padding:.3rem .9rem .3rem 0;border-bottom:1px solid var(--line)}td.number,th.number{text-align:right;white-space:nowrap}
.tag{display:inline-block;white-space:nowrap;padding:0 .5em;border-radius:4px;color:var(--on-flag)}footer{margin-top:2.5rem;font-size:.85rem;color:var(--soft)}
.scroll{overflow-x:auto}svg.narrow{display:none}@media screen and (max-width:40rem){main{padding:1rem .8rem 2rem}h1{font-size:1.35rem}.grid-2,.grid-3{grid-template-columns:1fr}
.tiles{grid-template-columns:repeat(auto-fit,minmax(9.5rem,1fr))}svg.wide{display:none}svg.narrow{display:block}figure{padding:.3rem .2rem}td,th{padding-right:.7rem}}
@media print{main{padding:0;max-width:none}.grid-3{grid-template-columns:repeat(2,1fr)}figure,tr,.tiles{break-inside:avoid}h2,h2+p{break-after:avoid}.tag{print-color-adjust:exact;-webkit-print-color-adjust:exact}}
";

/// A page of that title and body.
pub fn page(title: &str, body: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (title) }
                style { (PreEscaped(PALETTE)) (PreEscaped(STYLE)) }
            }
            body {
                main {
                    (body)
                    footer { "Made by seepd " (env!("CARGO_PKG_VERSION")) "." }
                }
            }
        }
    }
    .into_string()
}
