/* Rigid bodies joined by 6-DOF spring-dampers (law Standard, see laws.py), by hand and for speed.
 *
 * A second opinion and a yardstick: how fast are the rates when a person writes them for this
 * format of scenes alone? Scalar C99; no globals, no allocation. Monogram notation and states as in
 * scenes.py: a body has 13 states p_WB, q_WB (scalar first, any length), v_WB_W, w_WB_B.
 *
 * What makes it fast: each rotation matrix is made once per call; a connector works in body 0's
 * axes (marker frames are not turned against their bodies), so that body 0's torque needs no
 * rotation and body 1's comes out in its own axes; with marker 0 on the ground even that change of
 * axes is skipped; angles have an atan2 of their own; masses enter as reciprocals, and every
 * contribution goes straight into the rates.
 */
#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stddef.h>
#include <string.h>
#include <time.h>

typedef struct {
  double x, y, z;
} vec3;

typedef struct {
  vec3 x, y, z; /* rows */
} mat3;

typedef struct {
  double inverse_mass;
  vec3 inverse_inertia, gyration; /* gyration: (I_y - I_z)/I_x and its cyclic followers */
} hw_body;

typedef struct {
  int body0, body1;          /* -1 is the ground */
  vec3 position0, position1; /* in body axes, m */
  vec3 stiffness, torsional_stiffness, damping, torsional_damping; /* diagonals of K and D */
  vec3 offset, rotation_offset;
  const double *full; /* NULL, or K (6 x 6) and D (6 x 6) row by row, which then count */
} hw_connector;

typedef struct {
  int n_bodies, n_connectors;
  vec3 gravity;
  const hw_body *bodies;
  const hw_connector *connectors;
  mat3 *frames; /* scratch, n_bodies: R_WB of each body */
} hw_scene;

static inline vec3 load(const double *a) { return (vec3){a[0], a[1], a[2]}; }
static inline void store(vec3 a, double *out) { out[0] = a.x, out[1] = a.y, out[2] = a.z; }
static inline vec3 add(vec3 a, vec3 b) { return (vec3){a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline vec3 sub(vec3 a, vec3 b) { return (vec3){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline vec3 times(vec3 a, vec3 b) { return (vec3){a.x * b.x, a.y * b.y, a.z * b.z}; }
static inline vec3 scaled(double s, vec3 a) { return (vec3){s * a.x, s * a.y, s * a.z}; }
static inline double dot(vec3 a, vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

static inline vec3 cross(vec3 a, vec3 b) {
  return (vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* R a */
static inline vec3 rotate(const mat3 *R, vec3 a) {
  return (vec3){dot(R->x, a), dot(R->y, a), dot(R->z, a)};
}

/* R' a */
static inline vec3 rotate_back(const mat3 *R, vec3 a) {
  return add(add(scaled(a.x, R->x), scaled(a.y, R->y)), scaled(a.z, R->z));
}

/* A' B */
static inline mat3 between(const mat3 *A, const mat3 *B) {
  return (mat3){rotate_back(B, (vec3){A->x.x, A->y.x, A->z.x}),
                rotate_back(B, (vec3){A->x.y, A->y.y, A->z.y}),
                rotate_back(B, (vec3){A->x.z, A->y.z, A->z.z})};
}

#ifdef HW_LIBM
#define angle_of atan2
#else
/* atan2(y, x) within 2 ulp and inlined: one division brings |t| below 0.66, and there
 * atan t = t + t z P(z)/Q(z), z = t^2. Coefficients and ranges: S. L. Moshier, Cephes Math Library,
 * atan.c. Unlike atan2 it takes no infinite argument and ignores the sign of a zero. */
static inline double angle_of(double y, double x) {
  const double ay = fabs(y), ax = fabs(x);
  double t, z, p, q, angle, more;
  if (ay <= 0.66 * ax) {
    t = ax > 0 ? ay / ax : 0, angle = 0, more = 0;
  } else if (ay <= 2.41421356237309504880 * ax) {
    t = (ay - ax) / (ay + ax), angle = 7.85398163397448309616e-1, more = 3.061616997868382943e-17;
  } else {
    t = -ax / ay, angle = 1.57079632679489661923, more = 6.123233995736765886e-17;
  }
  z = t * t;
  p = (((-8.750608600031904122785e-1 * z - 1.615753718733365076637e1) * z
        - 7.500855792314704667340e1) * z - 1.228866684490136173410e2) * z
      - 6.485021904942025371773e1;
  q = ((((z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2) * z
        + 4.328810604912902668951e2) * z + 4.853903996359136964868e2) * z
      + 1.945506571482613964425e2;
  angle += more + (t * (z * p / q) + t);
  if (x < 0) angle = 3.14159265358979323846 - angle;
  return y < 0 ? -angle : angle;
}
#endif

/* For a test of it. */
double hw_angle_of(double y, double x) { return angle_of(y, x); }

/* What a body does alone: p' = v, q' = q (0, w)/2, v' = g, I w' = -w x I w; its R_WB on the side.
 * R = I + 2 (w [v]x + [v]x^2)/(q.q) for q = (w, v) [Shabana 2020, ch. 2]. */
static inline mat3 free_rates(const hw_body *body, vec3 gravity, const double *x, double *dx) {
  const double a = x[3], b = x[4], c = x[5], d = x[6];
  const double s = 2 / (a * a + b * b + c * c + d * d), sb = s * b, sc = s * c, sd = s * d;
  const vec3 w = load(x + 10);
  store(load(x + 7), dx);
  dx[3] = -0.5 * (b * w.x + c * w.y + d * w.z);
  dx[4] = 0.5 * (a * w.x + c * w.z - d * w.y);
  dx[5] = 0.5 * (a * w.y + d * w.x - b * w.z);
  dx[6] = 0.5 * (a * w.z + b * w.y - c * w.x);
  store(gravity, dx + 7);
  store(times(body->gyration, (vec3){w.y * w.z, w.z * w.x, w.x * w.y}), dx + 10);
  return (mat3){{1 - (sc * c + sd * d), sb * c - sd * a, sb * d + sc * a},
                {sb * c + sd * a, 1 - (sb * b + sd * d), sc * d - sb * a},
                {sb * d - sc * a, sc * d + sb * a, 1 - (sb * b + sc * c)}};
}

/* Adds a force (world) and a torque about the centre of mass (body axes) to a body's rates. */
static inline void add_wrench(const hw_body *body, vec3 force, vec3 torque, double *dx) {
  store(add(load(dx + 7), scaled(body->inverse_mass, force)), dx + 7);
  store(add(load(dx + 10), times(body->inverse_inertia, torque)), dx + 10);
}

/* (f, m) = K (d, angles) + D (v, w) with full matrices, row by row. */
static void multiply_full(
    const double *full, vec3 d, vec3 angles, vec3 v, vec3 w, vec3 *f, vec3 *m) {
  double out[6];
  for (int i = 0; i < 6; ++i) {
    const double *K = full + 6 * i, *D = K + 36;
    out[i] = dot(load(K), d) + dot(load(K + 3), angles) + dot(load(D), v) + dot(load(D + 3), w);
  }
  *f = load(out), *m = load(out + 3);
}

/* One connector. A is body 0's frame moved to marker 0, C body 1's moved to marker 1; R = R_AC.
 *
 *     d = R_0W (p_1 - p_0) + R r1 - r0
 *     v = R_0W (v_1 - v_0) + R (w1 x r1) - w0 x r0       (r and w of each body in its own axes)
 *     w = R w1 - w0
 *     (f, m) = K ([d; angles] - offset) + D [v; w]       (angles: Tait-Bryan xyz, R = Rx Ry Rz)
 *
 * Body 0 gets the force R_W0 f and the torque m + r0 x f in its axes, body 1 gets -R_W0 f and
 * -(R' m + r1 x R' f) in its own. For the element see laws.py. */
static inline void connector_rates(
    const hw_scene *s, const hw_connector *c, const double *x, double *restrict dx) {
  static const double at_rest[13] = {0}; /* state of the ground */
  static const mat3 identity = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}; /* and its frame */
  const int ground0 = c->body0 < 0, ground1 = c->body1 < 0;
  const double *x0 = ground0 ? at_rest : x + 13 * c->body0;
  const double *x1 = ground1 ? at_rest : x + 13 * c->body1;
  const mat3 *R0 = ground0 ? &identity : s->frames + c->body0;
  const mat3 *R1 = ground1 ? &identity : s->frames + c->body1;
  const vec3 r0 = c->position0, r1 = c->position1, w0 = load(x0 + 10), w1 = load(x1 + 10);
  mat3 R = *R1;
  vec3 d = sub(load(x1), load(x0)), v = sub(load(x1 + 7), load(x0 + 7));
  if (!ground0) {
    R = between(R0, R1);
    d = rotate_back(R0, d);
    v = rotate_back(R0, v);
  }
  d = sub(add(d, rotate(&R, r1)), add(r0, c->offset));
  v = sub(add(v, rotate(&R, cross(w1, r1))), cross(w0, r0));
  const vec3 w = sub(rotate(&R, w1), w0);
  const vec3 angles = {angle_of(-R.y.z, R.z.z) - c->rotation_offset.x,
                       angle_of(R.x.z, sqrt(R.x.x * R.x.x + R.x.y * R.x.y)) - c->rotation_offset.y,
                       angle_of(-R.x.y, R.x.x) - c->rotation_offset.z};
  vec3 f, m;
  if (c->full == NULL) {
    f = add(times(c->stiffness, d), times(c->damping, v));
    m = add(times(c->torsional_stiffness, angles), times(c->torsional_damping, w));
  } else {
    multiply_full(c->full, d, angles, v, w, &f, &m);
  }
  const vec3 force = ground0 ? f : rotate(R0, f);
  if (!ground0)
    add_wrench(s->bodies + c->body0, force, add(m, cross(r0, f)), dx + 13 * c->body0);
  if (!ground1) {
    const vec3 torque = add(rotate_back(&R, m), cross(r1, rotate_back(&R, f)));
    add_wrench(s->bodies + c->body1, scaled(-1, force), scaled(-1, torque), dx + 13 * c->body1);
  }
}

/* dx (13 n_bodies) = x' */
void hw_rates(const hw_scene *s, const double *x, double *restrict dx) {
  for (int i = 0; i < s->n_bodies; ++i)
    s->frames[i] = free_rates(s->bodies + i, s->gravity, x + 13 * i, dx + 13 * i);
  for (int i = 0; i < s->n_connectors; ++i) connector_rates(s, s->connectors + i, x, dx);
}

/* n equal steps of the 12-stage method of order 8 that DOP853 advances with, no error estimate;
 * x is start and end. Coefficients: Dormand and Prince, in the code DOP853 of Hairer, Norsett,
 * Wanner 1993, sec. II.10. work: 13 x 13 n_bodies. Returns 0, or 1 if the end is not finite. */
int hw_rk8(const hw_scene *s, double *restrict x, double t_end, int n, double *restrict work) {
  const int m = 13 * s->n_bodies;
  const double h = t_end / n;
  double *y = work, *k1 = y + m, *k2 = k1 + m, *k3 = k2 + m, *k4 = k3 + m, *k5 = k4 + m;
  double *k6 = k5 + m, *k7 = k6 + m, *k8 = k7 + m, *k9 = k8 + m, *k10 = k9 + m, *k11 = k10 + m;
  double *k12 = k11 + m, size = 0;
#define STAGE(k, sum)                                       \
  for (int i = 0; i < m; ++i) y[i] = x[i] + h * (sum);      \
  hw_rates(s, y, k)

  for (int step = 0; step < n; ++step) {
    hw_rates(s, x, k1);
    STAGE(k2, 5.26001519587677318785587544488e-2 * k1[i]);
    STAGE(k3, 1.97250569845378994544595329183e-2 * k1[i]
          + 5.91751709536136983633785987549e-2 * k2[i]);
    STAGE(k4, 2.95875854768068491816892993775e-2 * k1[i]
          + 8.87627564304205475450678981324e-2 * k3[i]);
    STAGE(k5, 2.41365134159266685502369798665e-1 * k1[i]
          - 8.84549479328286085344864962717e-1 * k3[i]
          + 9.24834003261792003115737966543e-1 * k4[i]);
    STAGE(k6, 3.7037037037037037037037037037e-2 * k1[i]
          + 1.70828608729473871279604482173e-1 * k4[i]
          + 1.25467687566822425016691814123e-1 * k5[i]);
    STAGE(k7, 3.7109375e-2 * k1[i] + 1.70252211019544039314978060272e-1 * k4[i]
          + 6.02165389804559606850219397283e-2 * k5[i] - 1.7578125e-2 * k6[i]);
    STAGE(k8, 3.70920001185047927108779319836e-2 * k1[i]
          + 1.70383925712239993810214054705e-1 * k4[i]
          + 1.07262030446373284651809199168e-1 * k5[i]
          - 1.53194377486244017527936158236e-2 * k6[i]
          + 8.27378916381402288758473766002e-3 * k7[i]);
    STAGE(k9, 6.24110958716075717114429577812e-1 * k1[i]
          - 3.36089262944694129406857109825 * k4[i] - 8.68219346841726006818189891453e-1 * k5[i]
          + 2.75920996994467083049415600797e1 * k6[i]
          + 2.01540675504778934086186788979e1 * k7[i]
          - 4.34898841810699588477366255144e1 * k8[i]);
    STAGE(k10, 4.77662536438264365890433908527e-1 * k1[i]
          - 2.48811461997166764192642586468 * k4[i] - 5.90290826836842996371446475743e-1 * k5[i]
          + 2.12300514481811942347288949897e1 * k6[i]
          + 1.52792336328824235832596922938e1 * k7[i]
          - 3.32882109689848629194453265587e1 * k8[i]
          - 2.03312017085086261358222928593e-2 * k9[i]);
    STAGE(k11, -9.3714243008598732571704021658e-1 * k1[i]
          + 5.18637242884406370830023853209 * k4[i] + 1.09143734899672957818500254654 * k5[i]
          - 8.14978701074692612513997267357 * k6[i] - 1.85200656599969598641566180701e1 * k7[i]
          + 2.27394870993505042818970056734e1 * k8[i] + 2.49360555267965238987089396762 * k9[i]
          - 3.0467644718982195003823669022 * k10[i]);
    STAGE(k12, 2.27331014751653820792359768449 * k1[i]
          - 1.05344954667372501984066689879e1 * k4[i] - 2.00087205822486249909675718444 * k5[i]
          - 1.79589318631187989172765950534e1 * k6[i]
          + 2.79488845294199600508499808837e1 * k7[i] - 2.85899827713502369474065508674 * k8[i]
          - 8.87285693353062954433549289258 * k9[i] + 1.23605671757943030647266201528e1 * k10[i]
          + 6.43392746015763530355970484046e-1 * k11[i]);
    for (int i = 0; i < m; ++i)
      x[i] += h * (5.42937341165687622380535766363e-2 * k1[i]
            + 4.45031289275240888144113950566 * k6[i] + 1.89151789931450038304281599044 * k7[i]
            - 5.8012039600105847814672114227 * k8[i] + 3.1116436695781989440891606237e-1 * k9[i]
            - 1.52160949662516078556178806805e-1 * k10[i]
            + 2.01365400804030348374776537501e-1 * k11[i]
            + 4.47106157277725905176885569043e-2 * k12[i]);
  }
#undef STAGE
  for (int i = 0; i < m; ++i) size += fabs(x[i]);
  return !isfinite(size);
}

static double cpu_seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* CPU seconds of one integration, x and work as above; -1 if its end is not finite. */
double hw_seconds_of_rk8(const hw_scene *s, double *x, double t_end, int n, double *work) {
  const double started = cpu_seconds();
  const int failed = hw_rk8(s, x, t_end, n, work);
  return failed ? -1 : cpu_seconds() - started;
}

/* CPU seconds of one call of hw_rates, mean over many; work: 2 x 13 n_bodies. Every call needs the
 * result of the one before (which changes almost nothing), so that none can be left out. */
double hw_seconds_per_call(const hw_scene *s, const double *x, int calls, double *work) {
  const int m = 13 * s->n_bodies;
  double *y = work, *dx = work + m;
  memcpy(y, x, (size_t)m * sizeof *y);
  const double started = cpu_seconds();
  for (int i = 0; i < calls; ++i) {
    hw_rates(s, y, dx);
    y[0] = x[0] + 1e-15 * dx[m - 1];
  }
  return (cpu_seconds() - started) / calls;
}
