/* The slide as an FMU for co-simulation by FMI 2.0, its controller outside: Heun's steps of 0.25 ms at most. */
#include <stdlib.h>
#include "axis.h"

enum { COMMAND, LOAD, POSITION, VELOCITY, FLOW, MASS, DAMPING, LAG, START, VARIABLES };
typedef struct { double value[VARIABLES]; State state; } Model;

static void planned(Model *m) {
  m->value[COMMAND] = m->value[LOAD] = m->value[START] = 0.0;
  m->value[FLOW] = PLANNED.flow; m->value[MASS] = PLANNED.mass;
  m->value[DAMPING] = PLANNED.damping; m->value[LAG] = PLANNED.lag;
}
static void shown(Model *m) { m->value[POSITION] = m->state.position; m->value[VELOCITY] = m->state.velocity; }

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const void *callbacks, int visible, int logging) {
  (void)name; (void)type; (void)guid; (void)resources; (void)callbacks; (void)visible; (void)logging;
  Model *m = calloc(1, sizeof *m);
  if (m) planned(m);
  return m;
}
void fmi2FreeInstance(void *m) { free(m); }
int fmi2Reset(void *m) { planned(m); return 0; }
int fmi2SetupExperiment(void *m, int d, double t, double start, int s, double stop) { (void)m; (void)d; (void)t; (void)start; (void)s; (void)stop; return 0; }
int fmi2EnterInitializationMode(void *m) { (void)m; return 0; }
int fmi2ExitInitializationMode(void *handle) {
  Model *m = handle;
  State start = { 0.0, 0.0, 0.0, m->value[START] };
  m->state = start;
  shown(m);
  return 0;
}
int fmi2SetReal(void *handle, const unsigned *vr, size_t n, const double *value) {
  Model *m = handle;
  for (size_t i = 0; i < n; i++) { if (vr[i] >= VARIABLES) return 3; m->value[vr[i]] = value[i]; }
  return 0;
}
int fmi2GetReal(void *handle, const unsigned *vr, size_t n, double *value) {
  Model *m = handle;
  for (size_t i = 0; i < n; i++) { if (vr[i] >= VARIABLES) return 3; value[i] = m->value[vr[i]]; }
  return 0;
}
int fmi2DoStep(void *handle, double t, double h, int p) {
  (void)t; (void)p;
  Model *m = handle;
  Parameters of = { m->value[FLOW], m->value[MASS], m->value[DAMPING], m->value[LAG] };
  int steps = (int)ceil(h / 2.5e-4);
  for (int i = 0; i < steps; i++) {
    double dt = h / steps;
    State first = rates(&of, m->state, m->value[COMMAND], m->value[LOAD]);
    State second = rates(&of, moved(m->state, first, dt), m->value[COMMAND], m->value[LOAD]);
    m->state = moved(moved(m->state, first, dt / 2), second, dt / 2);
  }
  shown(m);
  return 0;
}
