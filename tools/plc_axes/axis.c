/* A hydraulic axis behind a PLC, at steps of 0.02 ms: trapezoids of speed, an integrator that works near its target only, outputs of 12 bits,
 * a regulated or a fixed pump, lands that leak alike to both sides. The laws are written here from textbooks (Merritt, Hydraulic Control
 * Systems, 1967; Jelali and Kroll, Hydraulic Servo-systems, 2003) and share nothing with the program that adopts the machine.
 *
 *     axis KEY=VALUE...      CSV on standard output; the keys and their units are in `SETTINGS` below
 *     moves=TO_MM:M_PER_S:HOLD_S,...
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_MOVES = 16, WARM_UP_CYCLES = 3 };
static const double STEP_S = 2e-5, PI = 3.14159265358979323846, PA_PER_BAR = 1e5, LPM = 1.0 / 60000.0;

#define SETTINGS(S) \
  /* cylinder and what it moves: mm, kg; lifts: 1 where extending lifts the mass; litres of oil go with metres of hose of 16 mm */ \
  S(bore, 63) S(rod, 36) S(second_rod, 0) S(stroke, 300) S(mass, 120) S(lifts, 0) S(hose, 1.2) \
  /* friction: N, N, m/s, N s/m */ \
  S(coulomb, 300) S(breakaway, 450) S(stribeck, 0.01) S(viscous, 800) S(viscosity_swing, 0) \
  /* oil: Pa, share of air */ \
  S(bulk, 1.3e9) S(air, 0.01) \
  /* valve: L/min over both lands at bar; rod side over cap side; Hz; shares of full command; L/min a land at 70 bar over both */ \
  S(flow, 40) S(rated, 70) S(port_ratio, 1) S(natural, 60) S(damping, 0.8) S(null, 0.004) S(overlap, 0) \
  S(rounding, 0.004) S(hysteresis, 0.002) S(land_leak, 0.4) \
  /* supply: bar, bar, L/min, regulated (1) or fixed with a relief valve (0), bar per L/min, L of oil that it is worth */ \
  S(pressure, 160) S(tank, 3) S(pump, 60) S(regulated, 1) S(slope, 0.15) S(accumulator, 0.3) \
  /* controller: 1/m, s, mm, s/m, share, ms */ \
  S(kp, 30) S(reset, 0) S(window, 5) S(forward, 0) S(jump, 0) S(task, 2) \
  /* duty cycle: m/s2; trapezoids (0) or sines (1); whether every hold waits, and by how much a wait varies */ \
  S(acceleration, 2) S(sines, 0) S(events, 0) S(jitter, 0.05) S(cycles, 60) \
  /* what presses: N on moves out; N/mm from mm on; how much both vary from cycle to cycle */ \
  S(force, 0) S(stiffness, 0) S(contact, 0) S(load_varies, 0.01) \
  /* log: Hz, mm, mm, bits; the command alone (0) or with demand and position (1) */ \
  S(rate, 500) S(quantum, 0.005) S(noise, 0.003) S(bits, 12) S(signals, 1) \
  /* faults: L/min at 70 bar past the piston with its exponent, and from the cap chamber to the outside */ \
  S(leak, 0) S(exponent, 0.5) S(outside, 0) S(seed, 1)
#define FIELD(key, value) double key;
#define USUAL(key, value) .key = value,
#define NAMED(key, value) { #key, &is.key },
static struct { SETTINGS(FIELD) } is = { SETTINGS(USUAL) };
static const struct { const char *key; double *value; } named[] = { SETTINGS(NAMED) };

static struct { double to_m, speed, hold_s; } moves[MOST_MOVES];
static int move_count;

static void read_moves(const char *text) {
  int read = 0;
  while (move_count < MOST_MOVES &&
         sscanf(text, "%lf:%lf:%lf%n", &moves[move_count].to_m, &moves[move_count].speed, &moves[move_count].hold_s, &read) == 3) {
    moves[move_count++].to_m *= 1e-3;
    text += read;
    if (*text++ != ',') break;
  }
}

static void read_settings(int count, char **arguments) {
  for (int i = 1; i < count; i++) {
    char *equals = strchr(arguments[i], '=');
    if (!equals) exit(64);
    *equals++ = 0;
    if (!strcmp(arguments[i], "moves")) { read_moves(equals); continue; }
    size_t n = 0;
    while (n < sizeof named / sizeof *named && strcmp(named[n].key, arguments[i])) n++;
    if (n == sizeof named / sizeof *named) {
      fprintf(stderr, "axis: no setting is called %s\n", arguments[i]);
      exit(64);
    }
    *named[n].value = atof(equals);
  }
}

static uint64_t state;
static double uniform(void) {
  state ^= state << 13; state ^= state >> 7; state ^= state << 17;
  return (double)(state >> 11) / 9007199254740992.0;
}
static double normal(void) {
  double radius = sqrt(-2.0 * log(1.0 - uniform()));
  return radius * cos(2.0 * PI * uniform());
}
static double sign(double x) { return (x > 0) - (x < 0); }
static double root(double x) { return sign(x) * sqrt(fabs(x)); }
static double circle(double mm) { return PI / 4.0 * mm * mm * 1e-6; }
/* How far a land is open: nothing below its overlap, a line above it, round between them. */
static double opened(double spool, double overlap, double rounding) {
  double beyond = (spool - overlap) / rounding;
  return (beyond > 40 ? spool - overlap : rounding * log1p(exp(beyond))) / (1.0 - overlap);
}

static struct { double x, v, cap, rod, supply, spool, spool_speed, stuck; } m;
static struct { double integral, before, last; } c;

/* One step of the plant under a command and a force that presses against the piston. */
static void step(double command, double pressing_n, double thick) {
  const double h = STEP_S, cap_m2 = circle(is.bore) - circle(is.second_rod), rod_m2 = circle(is.bore) - circle(is.rod);
  const double stroke_m = is.stroke * 1e-3, dead_m3 = is.hose * circle(16) + 0.03 * cap_m2 * stroke_m + 2e-5;
  const double half = is.hysteresis / 2, w = 2 * PI * is.natural;
  if (command - m.stuck > half) m.stuck = command - half;
  else if (command - m.stuck < -half) m.stuck = command + half;
  m.spool_speed += h * (w * w * (m.stuck + is.null - m.spool) - 2 * is.damping * w * m.spool_speed);
  m.spool += h * m.spool_speed;

  const double land = is.flow * LPM / sqrt(is.rated * PA_PER_BAR / 2), leaking = is.land_leak * LPM / sqrt(35 * PA_PER_BAR);
  const double worn = leaking * exp(-fabs(m.spool) / 0.02), tank = is.tank * PA_PER_BAR, ratio = is.port_ratio;
  const double out = opened(m.spool, is.overlap, is.rounding), back = opened(-m.spool, is.overlap, is.rounding);
  const double to_cap = root(m.supply - m.cap), from_cap = root(m.cap - tank), to_rod = root(m.supply - m.rod), from_rod = root(m.rod - tank);
  const double into_cap = land * (out * to_cap - back * from_cap) + worn * (to_cap - from_cap);
  const double into_rod = land * ratio * (back * to_rod - out * from_rod) + worn * (to_rod - from_rod);
  const double over = m.cap - m.rod;
  const double seal = is.leak * LPM * sign(over) * pow(fabs(over) / (70 * PA_PER_BAR), is.exponent);
  const double outside = is.outside * LPM * sqrt(m.cap / (70 * PA_PER_BAR));
  const double soft = is.air * is.bulk * PA_PER_BAR;
  const double cap_bulk = is.bulk / (1 + soft / (m.cap * m.cap)), rod_bulk = is.bulk / (1 + soft / (m.rod * m.rod));
  m.cap += h * cap_bulk / (dead_m3 + cap_m2 * m.x) * (into_cap - cap_m2 * m.v - seal - outside);
  m.rod += h * rod_bulk / (dead_m3 + rod_m2 * (stroke_m - m.x)) * (into_rod + rod_m2 * m.v + seal);
  m.cap = fmax(m.cap, 0.2 * PA_PER_BAR);
  m.rod = fmax(m.rod, 0.2 * PA_PER_BAR);

  const double drawn = land * (out * to_cap + ratio * back * to_rod) + worn * (to_cap + to_rod), pump = is.pump * LPM;
  double towards = (is.pressure - is.slope * (is.regulated > 0 ? drawn : drawn > pump ? 0 : drawn) / LPM) * PA_PER_BAR;
  if (drawn > pump) towards = is.regulated > 0 ? m.supply - 1e7 * (drawn / pump - 1) : m.supply - 1e8;
  m.supply = fmax(m.supply + h * (towards - m.supply) / (0.01 + 0.05 * is.accumulator), tank);

  const double slow = m.v / is.stribeck;
  const double friction = (is.coulomb + (is.breakaway - is.coulomb) * exp(-slow * slow)) * tanh(m.v / 2e-4) + thick * is.viscous * m.v;
  const double force = m.cap * cap_m2 - m.rod * rod_m2 - friction - pressing_n;
  const int at_a_stop = (m.x <= 0 && force < 0 && m.v <= 0) || (m.x >= stroke_m && force > 0 && m.v >= 0);
  if (at_a_stop) { m.v = 0; m.x = m.x <= 0 ? 0 : stroke_m; return; }
  m.v += h * force / is.mass;
  m.x += h * m.v;
}

/* Where a move is after some time. */
static double asked(double from, double to, double speed, double t, double *lasts) {
  const double way = fabs(to - from), a = is.acceleration;
  if (is.sines > 0) {
    *lasts = way / speed * PI / 2;
    return t >= *lasts ? to : from + (to - from) * (0.5 - 0.5 * cos(PI * t / *lasts));
  }
  if (speed * speed > way * a) speed = sqrt(way * a);
  const double ramp = speed / a;
  *lasts = way / speed + ramp;
  if (t >= *lasts) return to;
  const double left = *lasts - t;
  const double gone = t < ramp ? 0.5 * a * t * t : left > ramp ? speed * (t - ramp / 2) : way - 0.5 * a * left * left;
  return from + sign(to - from) * gone;
}

static double controlled(double demand, double measured) {
  const double task = is.task * 1e-3, error = demand - measured;
  if (is.reset > 0 && fabs(error) < is.window * 1e-3) c.integral += is.kp / is.reset * error * task;
  c.integral = fmax(-0.1, fmin(0.1, c.integral));
  double u = is.kp * error + c.integral + is.forward * (demand - c.before) / task;
  c.before = demand;
  u += is.jump * fmax(-1, fmin(1, u / 0.002));
  const double most = pow(2, is.bits - 1);
  return floor(fmax(-1, fmin(1, u)) * most + 0.5) / most;
}

int main(int count, char **arguments) {
  read_settings(count, arguments);
  if (!move_count) return 64;
  state = 88172645463325252ull ^ ((uint64_t)is.seed * 0x9E3779B97F4A7C15ull);
  for (int i = 0; i < 50; i++) uniform();
  const double task = is.task * 1e-3;
  const int substeps = (int)(task / STEP_S + 0.5), nth = (int)(1 / is.rate / task + 0.5), has_position = is.signals > 0;
  m.x = c.before = moves[move_count - 1].to_m;
  m.cap = 40 * PA_PER_BAR; m.rod = 60 * PA_PER_BAR; m.supply = is.pressure * PA_PER_BAR;
  long tick = 0;
  double pressed = 0, t = 0;
  puts(has_position ? "time_s,Y_valve_pct,setpoint_mm,position_mm" : "time_s,Y_valve_pct");
  for (int cycle = -WARM_UP_CYCLES; cycle < is.cycles; cycle++) {
    const double varies = 1 + is.load_varies * normal(), weighs = 1 + is.load_varies * normal();
    const double thick = 1 + is.viscosity_swing * sin(2 * PI * tick * task / 3600);
    for (int k = 0; k < move_count; k++) {
      const double from = c.before, to = moves[k].to_m;
      double lasts;
      asked(from, to, moves[k].speed, 0, &lasts);
      const int waits = k == move_count - 1 || is.events > 0;
      const double hold = moves[k].hold_s * (waits ? 1 + is.jitter * (2 * uniform() - 1) : 1);
      for (int n = (int)((lasts + hold) / task + 0.5), i = 0; i < n; i++, tick++) {
        const double demand = asked(from, to, moves[k].speed, i * task, &lasts);
        const double seen = floor((m.x * 1e3 + is.noise * normal()) / is.quantum + 0.5) * is.quantum;
        const double command = controlled(demand, seen * 1e-3);
        if (cycle >= 0 && tick % nth == 0) {
          printf("%.4f,%.4f", t, 100 * command);
          if (has_position) printf(",%.4f,%.4f", demand * 1e3, seen);
          putchar('\n');
        }
        /* What presses grows over the first third of a move out, and lets go in the first fifth of one back. */
        const double share = fmin(1, i * task / lasts);
        if (to > from) pressed = is.force * fmin(1, share / 0.3);
        else if (share < 0.2) pressed *= 1 - task / 0.01 * fmin(1, 0.01 / task);
        for (int j = 0; j < substeps; j++) {
          const double touching = is.stiffness * 1e3 * fmax(0, m.x - is.contact * 1e-3) * (is.stiffness > 0);
          step(c.last, varies * (pressed + touching) + is.lifts * weighs * is.mass * 9.81, thick);
        }
        c.last = command; /* a task later, as outputs are written */
        if (cycle >= 0) t += task;
      }
    }
  }
  return 0;
}
