// MuJoCo's own steps, with commanded springs and the drag of the paper's eq. (1) as its passive
// force: what a user of MuJoCo in C would write. No Python runs within a trajectory.
//
// What the force needs of a chain lies in the `userdata` of its mjData, so that threads may
// simulate different chains: for each link 1/2 rho C_D L d, the stiffness of its joint, and the
// command at the last corner with its slope; then the time of that corner.

#include <mujoco/mujoco.h>
#include <pthread.h>

static void passive(const mjModel* m, mjData* d) {
  const int n = m->nv;
  const mjtNum *drag = d->userdata, *stiffness = drag + n;
  const mjtNum *command = stiffness + n, *slope = command + n;
  const mjtNum since = d->time - slope[n];
  const mjtNum* about = d->subtree_com + 3;
  // Force, and moment about the centre of mass of the chain, of the links from the tip on.
  mjtNum force[3] = {0, 0, 0}, moment[3] = {0, 0, 0};
  for (int i = n - 1; i >= 0; i--) {
    const mjtNum *spatial = d->cvel + 6 * (i + 1), *axis = d->cdof + 6 * i;
    const mjtNum* site = d->site_xpos + 3 * i;
    const mjtNum at[3] = {site[0] - about[0], site[1] - about[1], site[2] - about[2]};
    const mjtNum velocity[3] = {
        spatial[3] + spatial[1] * at[2] - spatial[2] * at[1],
        spatial[4] + spatial[2] * at[0] - spatial[0] * at[2],
        spatial[5] + spatial[0] * at[1] - spatial[1] * at[0],
    };
    const mjtNum factor =
        -drag[i] * mju_sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1] +
                            velocity[2] * velocity[2]);
    const mjtNum own[3] = {factor * velocity[0], factor * velocity[1], factor * velocity[2]};
    force[0] += own[0];
    force[1] += own[1];
    force[2] += own[2];
    moment[0] += at[1] * own[2] - at[2] * own[1];
    moment[1] += at[2] * own[0] - at[0] * own[2];
    moment[2] += at[0] * own[1] - at[1] * own[0];
    d->qfrc_passive[i] += axis[0] * moment[0] + axis[1] * moment[1] + axis[2] * moment[2] +
                          axis[3] * force[0] + axis[4] * force[1] + axis[5] * force[2] +
                          stiffness[i] * (command[i] + slope[i] * since);
  }
}

// The callback is global to MuJoCo: on while this library computes, and then what it was.
static mjfGeneric before;

static void begin(void) {
  before = mjcb_passive;
  mjcb_passive = passive;
}

static void end(void) { mjcb_passive = before; }

// The ends of all links, shape (joint, 3).
static void ends(const mjModel* m, mjData* d, const mjtNum* length, mjtNum* out) {
  mj_kinematics(m, d);
  for (int i = 0; i < m->nv; i++)
    for (int k = 0; k < 3; k++)
      out[3 * i + k] = d->xpos[3 * (i + 1) + k] + length[i] * d->xmat[9 * (i + 1) + 3 * k];
}

// Steps of one length from rest. `samples` and `corners` are numbers of steps, in order; `lines`
// holds the command at each corner and its slope. Returns the number of steps that were done:
// fewer than asked for where MuJoCo found the state to be bad.
long trajectory(const mjModel* m, mjData* d, long corner_count, const long* corners,
                const mjtNum* lines, long sample_count, const long* samples, const mjtNum* length,
                mjtNum* out) {
  const int n = m->nv;
  long done = 0, sample = 0, corner = 0;
  begin();
  for (;; done++) {
    d->time = done * m->opt.timestep;
    while (corner < corner_count && corners[corner] <= done) {
      mju_copy(d->userdata + 2 * n, lines + 2 * n * corner, 2 * n);
      d->userdata[4 * n] = corners[corner++] * m->opt.timestep;
    }
    while (sample < sample_count && samples[sample] == done)
      ends(m, d, length, out + 3 * n * sample++);
    if (sample == sample_count) break;
    mj_step(m, d);
    if (d->warning[mjWARN_BADQPOS].number + d->warning[mjWARN_BADQVEL].number +
        d->warning[mjWARN_BADQACC].number)
      break;
  }
  end();
  return done;
}

// `loop` evaluations of the accelerations, each of which needs the one before.
static void again(const mjModel* m, mjData* d, long loop) {
  for (long i = 0; i < loop; i++) {
    mj_forward(m, d);
    mju_addToScl(d->qpos, d->qacc, 1e-9, m->nv);
  }
}

void evaluations(const mjModel* m, mjData* d, long loop) {
  begin();
  again(m, d, loop);
  end();
}

typedef struct {
  const mjModel* model;
  mjData* data;
  long items, loop;
  mjtNum *angles, *rates, *commands, *accelerations;
} Share;

static void* work(void* given) {
  const Share* s = given;
  const int n = s->model->nv;
  for (long i = 0; i < s->items; i++) {
    mju_copy(s->data->qpos, s->angles + n * i, n);
    mju_copy(s->data->qvel, s->rates + n * i, n);
    mju_copy(s->data->userdata + 2 * n, s->commands + n * i, n);
    again(s->model, s->data, s->loop);
    mju_copy(s->accelerations + n * i, s->data->qacc, n);
  }
  return NULL;
}

// The same for many states, on as many threads as there are mjData.
void batch(const mjModel* m, long threads, mjData** data, long items, long loop, mjtNum* angles,
           mjtNum* rates, mjtNum* commands, mjtNum* accelerations) {
  pthread_t started[64];
  Share shares[64];
  begin();
  for (long t = 0; t < threads; t++) {
    const long first = items * t / threads, last = items * (t + 1) / threads;
    const long offset = first * m->nv;
    shares[t] = (Share){m, data[t], last - first, loop,
                        angles + offset, rates + offset, commands + offset,
                        accelerations + offset};
    pthread_create(&started[t], NULL, work, &shares[t]);
  }
  for (long t = 0; t < threads; t++) pthread_join(started[t], NULL);
  end();
}
