/* A small, fast servo-hydraulic slide: spool with a lag, flow by the root of what load pressure leaves of the supply, an oil spring, a mass.
 * The equations of both the FMU and the machines whose logs are made; each has its own integration. SI. */
#ifndef AXIS_H
#define AXIS_H
#include <math.h>

typedef struct { double flow, mass, damping, lag; } Parameters; /* m3/s at full opening and no load, kg, N s/m, s */
typedef struct { double spool, load_pressure, velocity, position; } State;

static const Parameters PLANNED = { 4e-4, 40.0, 800.0, 3e-3 };
static const double AREA = 5e-4, SUPPLY = 7e6, OIL_SPRING = 2.5e-13 /* m3/Pa */, LEAK = 1e-12 /* m3/(s Pa) */;

static State rates(const Parameters *p, State s, double command, double force) {
  double left = 1.0 - copysign(s.load_pressure, s.spool * s.load_pressure) / SUPPLY;
  double flow = p->flow * s.spool * sqrt(left > 0.0 ? left : 0.0);
  State rate = {
    (command - s.spool) / p->lag,
    (flow - AREA * s.velocity - LEAK * s.load_pressure) / OIL_SPRING,
    (AREA * s.load_pressure - p->damping * s.velocity + force) / p->mass,
    s.velocity,
  };
  return rate;
}

static State moved(State s, State rate, double dt) {
  State next = { s.spool + dt * rate.spool, s.load_pressure + dt * rate.load_pressure,
                 s.velocity + dt * rate.velocity, s.position + dt * rate.position };
  return next;
}
#endif
