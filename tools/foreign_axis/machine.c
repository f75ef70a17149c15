/* A machine with the slide, its controller and one thing that the FMU lacks, at steps of 0.05 ms; writes a log. The laws are written here from
 * their equations (docs/effects.md), and share nothing with the program that diagnoses.
 * machine SEED CYCLES FLOW MASS DAMPING EFFECT VALUE... : CSV on standard output; parameters are factors. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "axis.h"

static const double PERIOD = 2e-3, CYCLE = 3.0, KP = 10.0, KI = 40.0;
static const int SUBSTEPS = 40;
enum { HISTORY = 1024, WARM_UP = 3 };

static uint64_t noise_state = 1;
static double uniform(void) {
  noise_state ^= noise_state << 13; noise_state ^= noise_state >> 7; noise_state ^= noise_state << 17;
  return (double)(noise_state >> 11) / 9007199254740992.0;
}
static double normal(void) {
  double radius = sqrt(-2.0 * log(1.0 - uniform()));
  return radius * cos(6.283185307179586 * uniform());
}
static double stroke(double t, double from, double to) {
  double s = (t - from) / (to - from);
  s = s < 0.0 ? 0.0 : s > 1.0 ? 1.0 : s;
  return s * s * s * (10.0 + s * (6.0 * s - 15.0));
}
static double demand_at(double t) {
  t = fmod(t, CYCLE);
  return 0.05 + 0.2 * stroke(t, 0.1, 0.7) - 0.12 * stroke(t, 0.95, 1.25) - 0.08 * stroke(t, 1.4, 1.8);
}

int main(int argc, char **argv) {
  if (argc < 7) return 64;
  noise_state = 88172645463325252ull ^ (strtoull(argv[1], NULL, 10) * 0x9E3779B97F4A7C15ull);
  for (int i = 0; i < 20; i++) uniform();
  int cycles = atoi(argv[2]);
  Parameters p = { PLANNED.flow * atof(argv[3]), PLANNED.mass * atof(argv[4]), PLANNED.damping * atof(argv[5]), PLANNED.lag };
  const char *effect = argv[6];
  double v[3] = { 0 };
  for (int i = 0; i < 3 && i + 7 < argc; i++) v[i] = atof(argv[i + 7]);
#define IS(name) (strcmp(effect, name) == 0)
  double kp = IS("controller_gains") ? KP * v[0] : KP, ki = IS("controller_gains") ? KI * v[1] : KI;
  double period = IS("controller_clock") ? PERIOD * v[0] / 1e-3 : PERIOD, dt = period / SUBSTEPS;
  State s = { 0.0, 0.0, 0.0, demand_at(0.0) };
  double integral = 0.0, play = 0.0, valve = 0.0, valve_rate = 0.0, limited = 0.0, lagging = s.position;
  static double sent[HISTORY];
  long substep = 0;
  int ticks = (int)(CYCLE / PERIOD + 0.5);
  printf("t_s,command,demand,position\n");
  for (int tick = 0; tick < ticks * (cycles + WARM_UP); tick++) {
    double seen = s.position;
    if (IS("position_scale")) seen *= v[0];
    if (IS("position_sine")) seen += v[0] * sin(6.283185307179586 * seen / v[1]);
    if (IS("position_lag")) { double kept = exp(-period / v[0]); lagging = lagging * kept + seen * (1.0 - kept); seen = lagging; }
    if (IS("position_quantisation")) seen = v[0] * round(seen / v[0]);
    double demand = demand_at(tick * PERIOD), error = demand - seen;
    double next = integral + ki * PERIOD * error, u = kp * error + next;
    if (fabs(u) <= 1.0 || u * error < 0.0) integral = next;
    u = kp * error + integral;
    u = u > 1.0 ? 1.0 : u < -1.0 ? -1.0 : u;
    if (tick >= WARM_UP * ticks) {
      printf("%.3f,%.7f,%.7f,%.8f\n", (tick - WARM_UP * ticks) * PERIOD, u + 5e-4 * normal(), demand, seen + 5e-6 * normal());
    }
    for (int i = 0; i < SUBSTEPS; i++, substep++) {
      sent[substep % HISTORY] = u;
      double c = u;
      if (IS("command_quantisation")) c = v[0] * round(c / v[0]);
      if (IS("command_delay")) { long back = substep - (long)(v[0] / dt + 0.5); c = back < 0 ? 0.0 : sent[back % HISTORY]; }
      if (IS("valve_hysteresis")) { double half = v[0] / 2; play = play < c - half ? c - half : play > c + half ? c + half : play; c = play; }
      if (IS("valve_rate_limit")) { double most = v[0] * dt, d = c - limited; limited += d > most ? most : d < -most ? -most : d; c = limited; }
      if (IS("valve_lag")) {
        double w = 6.283185307179586 * v[0];
        valve_rate += dt * (w * w * (c - valve) - 2.0 * v[1] * w * valve_rate);
        valve += dt * valve_rate;
        c = valve;
      }
      if (IS("valve_bias")) c += v[0];
      if (IS("valve_deadband")) c = fabs(c) > v[0] ? c - copysign(v[0], c) : 0.0;
      if (IS("valve_flow_shape")) c = copysign(pow(fabs(c), v[0]), c);
      double force = 0.0, direction = tanh(s.velocity / 5e-3);
      if (IS("coulomb_friction")) force -= v[0] * direction;
      if (IS("stribeck_friction")) force -= (v[0] + (v[1] - v[0]) * exp(-pow(s.velocity / v[2], 2))) * direction;
      if (IS("spring_load")) force -= v[0] * (s.position - v[1]);
      if (IS("load_bias")) force += v[0];
      State a = rates(&p, s, c, force), b = rates(&p, moved(s, a, dt / 2), c, force);
      State d = rates(&p, moved(s, b, dt / 2), c, force), e = rates(&p, moved(s, d, dt), c, force);
      s = moved(moved(moved(moved(s, a, dt / 6), b, dt / 3), d, dt / 3), e, dt / 6);
    }
  }
  return isfinite(s.position) ? 0 : 70;
}
