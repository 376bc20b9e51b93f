// Explicit Runge-Kutta steps of one length over the code that CasADi generated, which is put before
// this file. A state is, one after the other, the angles, their derivatives by each of the
// parameters, the rates, and theirs; without derivatives just angles and rates.

#include <string.h>

#define MOST_STAGES 4

// Enough scratch space for each of the generated functions.
static long room(void) {
  int (*const work[])(casadi_int*, casadi_int*, casadi_int*, casadi_int*) = {
      motion_work, motion_and_tangents_work, ends_work, ends_and_tangents_work};
  long most = 1;
  for (int i = 0; i < 4; i++) {
    casadi_int arguments, results, integers, reals;
    work[i](&arguments, &results, &integers, &reals);
    if (integers > most) most = integers;
    if (reals > most) most = reals;
  }
  return most;
}

static void slope(long n, long directions, const double* state, const double* command,
                  const double* parameters, double* out, casadi_int* iw, double* w) {
  const long half = n * (1 + directions);
  const double* rates = state + half;
  const casadi_real* given[6] = {state, rates, command, parameters, state + n, rates + n};
  casadi_real* result[2] = {out + half, out + half + n};
  memcpy(out, rates, half * sizeof(double));
  (directions ? motion_and_tangents : motion)(given, result, iw, w, 0);
}

// From rest. `samples` and `corners` are numbers of steps, in order; `lines` holds the command at
// each corner and its slope; `out` the ends of the links at the samples, and their derivatives.
void trajectory(long n, long directions, long stages, const double* below, const double* weights,
                const double* nodes, double step, long corner_count, const long* corners,
                const double* lines, long sample_count, const long* samples,
                const double* parameters, double* out) {
  const long size = 2 * n * (1 + directions);
  double state[size], trial[size], slopes[MOST_STAGES][size], command[n];
  casadi_int iw[room()];
  double w[room()];
  memset(state, 0, sizeof(state));
  long corner = -1, sample = 0;
  for (long done = 0;; done++) {
    while (corner + 1 < corner_count && corners[corner + 1] <= done) corner++;
    while (sample < sample_count && samples[sample] == done) {
      const casadi_real* given[2] = {state, state + n};
      double* here = out + 3 * n * (1 + directions) * sample++;
      casadi_real* result[2] = {here, here + 3 * n};
      (directions ? ends_and_tangents : ends)(given, result, iw, w, 0);
    }
    if (sample == sample_count) return;
    const double* line = lines + 2 * n * corner;
    for (long s = 0; s < stages; s++) {
      memcpy(trial, state, sizeof(state));
      for (long r = 0; r < s; r++) {
        const double factor = step * below[s * stages + r];
        if (factor != 0)
          for (long i = 0; i < size; i++) trial[i] += factor * slopes[r][i];
      }
      const double since = (done + nodes[s] - corners[corner]) * step;
      for (long i = 0; i < n; i++) command[i] = line[i] + line[n + i] * since;
      slope(n, directions, trial, command, parameters, slopes[s], iw, w);
    }
    for (long s = 0; s < stages; s++)
      for (long i = 0; i < size; i++) state[i] += step * weights[s] * slopes[s][i];
  }
}

// `loop` evaluations of the accelerations, each of which needs the one before.
void evaluations(long n, long loop, double* angles, const double* rates, const double* command,
                 const double* parameters, double* accelerations) {
  casadi_int iw[room()];
  double w[room()];
  const casadi_real* given[4] = {angles, rates, command, parameters};
  casadi_real* result[1] = {accelerations};
  for (long i = 0; i < loop; i++) {
    motion(given, result, iw, w, 0);
    for (long k = 0; k < n; k++) angles[k] += 1e-9 * accelerations[k];
  }
}
