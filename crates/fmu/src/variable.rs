//! The variables of a model: what they are called, in which unit, and what may be done with them when.

/// Type of a variable; values of both are kept as numbers, a truth as 0 or 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A number.
    Real,
    /// True or false.
    Boolean,
}

/// What a variable is to the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Causality {
    /// Time.
    Independent,
    /// Set at every step.
    Input,
    /// Read after every step.
    Output,
    /// Set by whoever knows the machine.
    Parameter,
}

impl Causality {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Causality::Independent => "independent",
            Causality::Input => "input",
            Causality::Output => "output",
            Causality::Parameter => "parameter",
        }
    }
}

/// When a variable changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variability {
    /// At any time.
    Continuous,
    /// Now and then.
    Discrete,
    /// Not after the start.
    Fixed,
    /// Between steps, by whoever simulates.
    Tunable,
}

impl Variability {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Variability::Continuous => "continuous",
            Variability::Discrete => "discrete",
            Variability::Fixed => "fixed",
            Variability::Tunable => "tunable",
        }
    }
}

/// A variable. Its value reference is its place in [`Simulation::variables`](crate::Simulation::variables).
#[derive(Debug, Clone, PartialEq)]
pub struct Variable {
    /// Name: a signal's, or a parameter's dotted key in the plant file.
    pub name: String,
    /// Type.
    pub kind: Kind,
    /// What it is to the model.
    pub causality: Causality,
    /// When it changes.
    pub variability: Variability,
    /// SI unit; "1" for shares, counts and truths.
    pub unit: &'static str,
    /// Value before anybody sets one. Outputs and time have none to be told.
    pub start: f64,
    /// Least and largest value, where there are any.
    pub bounds: (Option<f64>, Option<f64>),
    /// What it is, in a phrase.
    pub description: String,
}

/// Variables as they are put together; places count from 0, which is time.
#[derive(Debug)]
pub(crate) struct Variables(Vec<Variable>);

impl Variables {
    pub(crate) fn new() -> Self {
        Variables(vec![Variable {
            name: "time".into(),
            kind: Kind::Real,
            causality: Causality::Independent,
            variability: Variability::Continuous,
            unit: "s",
            start: 0.0,
            bounds: (None, None),
            description: "time".into(),
        }])
    }

    fn add(&mut self, variable: Variable) -> usize {
        self.0.push(variable);
        self.0.len() - 1
    }

    pub(crate) fn input(&mut self, name: &str, unit: &'static str, start: f64, description: &str) -> usize {
        self.add(Variable {
            name: name.into(),
            kind: Kind::Real,
            causality: Causality::Input,
            variability: Variability::Continuous,
            unit,
            start,
            bounds: (None, None),
            description: description.into(),
        })
    }

    pub(crate) fn output(&mut self, name: &str, unit: &'static str, description: &str) -> usize {
        self.add(Variable {
            name: name.into(),
            kind: Kind::Real,
            causality: Causality::Output,
            variability: Variability::Continuous,
            unit,
            start: 0.0,
            bounds: (None, None),
            description: description.into(),
        })
    }

    /// An output that changes at the end of cycles.
    pub(crate) fn finding(&mut self, name: &str, kind: Kind, unit: &'static str, description: &str) -> usize {
        let place = self.output(name, unit, description);
        self.0[place].kind = kind;
        self.0[place].variability = Variability::Discrete;
        place
    }

    pub(crate) fn parameter(
        &mut self,
        (name, unit): (&str, &'static str),
        start: f64,
        bounds: (Option<f64>, Option<f64>),
        description: &str,
    ) -> usize {
        // What the machine's file has may lie outside of what is usual.
        let bounds = (bounds.0.map(|low| low.min(start)), bounds.1.map(|high| high.max(start)));
        self.add(Variable {
            name: name.into(),
            kind: Kind::Real,
            causality: Causality::Parameter,
            variability: Variability::Fixed,
            unit,
            start,
            bounds,
            description: description.into(),
        })
    }

    pub(crate) fn tunable(&mut self, place: usize) {
        self.0[place].variability = Variability::Tunable;
    }

    pub(crate) fn into_vec(self) -> Vec<Variable> {
        self.0
    }
}
