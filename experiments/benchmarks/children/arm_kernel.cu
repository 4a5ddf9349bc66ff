// Steps of a chain of revolute joints, one thread an arm: RNEA, the mass matrix from its columns, semi-implicit Euler.
// Compiled with REAL, N (joints), JOINTS (table below), and, without a graphics card, with HOST.
#ifdef HOST
#include <math.h>
#define __device__
#endif

struct Joint {  // of link i in its parent's frame; inertia about the centre of mass, in the link's frame
    REAL turn[9], place[3], axis[3], mass, centre[3], inertia[9];
};
__device__ static const Joint JOINT[N] = JOINTS;

__device__ static void cross(const REAL* a, const REAL* b, REAL* c) {
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

// Rotations from links to their parents at q, shape (N, 9).
__device__ static void rotations(const REAL* q, REAL r[N][9]) {
    for (int i = 0; i < N; i++) {
        const REAL *u = JOINT[i].axis, s = sin(q[i]), c = cos(q[i]), d = 1 - c;
        REAL t[9] = {c + u[0] * u[0] * d, u[0] * u[1] * d - u[2] * s, u[0] * u[2] * d + u[1] * s,
                     u[0] * u[1] * d + u[2] * s, c + u[1] * u[1] * d, u[1] * u[2] * d - u[0] * s,
                     u[0] * u[2] * d - u[1] * s, u[1] * u[2] * d + u[0] * s, c + u[2] * u[2] * d};
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++)
                r[i][3 * j + k] = JOINT[i].turn[3 * j] * t[k] + JOINT[i].turn[3 * j + 1] * t[3 + k] +
                                  JOINT[i].turn[3 * j + 2] * t[6 + k];
    }
}

// Torque of a motion; gravity along -z of the base.
__device__ static void rnea(const REAL r[N][9], const REAL* dq, const REAL* ddq, REAL gravity, REAL* torque) {
    REAL w[3] = {0, 0, 0}, dw[3] = {0, 0, 0}, a[3] = {0, 0, gravity}, force[N][3], moment[N][3];
    for (int i = 0; i < N; i++) {
        const Joint& b = JOINT[i];
        REAL t[3], s[3], at[3], parent[3][3];
        cross(dw, b.place, t);
        cross(w, b.place, s);
        cross(w, s, at);
        for (int k = 0; k < 3; k++) parent[0][k] = w[k], parent[1][k] = dw[k], parent[2][k] = a[k] + t[k] + at[k];
        for (int k = 0; k < 3; k++) {
            w[k] = dw[k] = a[k] = 0;
            for (int j = 0; j < 3; j++) {
                w[k] += r[i][3 * j + k] * parent[0][j];
                dw[k] += r[i][3 * j + k] * parent[1][j];
                a[k] += r[i][3 * j + k] * parent[2][j];
            }
        }
        cross(w, b.axis, t);
        for (int k = 0; k < 3; k++) dw[k] += t[k] * dq[i] + b.axis[k] * ddq[i];
        for (int k = 0; k < 3; k++) w[k] += b.axis[k] * dq[i];
        cross(dw, b.centre, t);
        cross(w, b.centre, s);
        cross(w, s, at);
        for (int k = 0; k < 3; k++) force[i][k] = b.mass * (a[k] + t[k] + at[k]);
        for (int k = 0; k < 3; k++) t[k] = s[k] = 0;
        for (int k = 0; k < 3; k++)
            for (int j = 0; j < 3; j++) t[k] += b.inertia[3 * k + j] * w[j], s[k] += b.inertia[3 * k + j] * dw[j];
        cross(w, t, at);
        cross(b.centre, force[i], t);
        for (int k = 0; k < 3; k++) moment[i][k] = s[k] + at[k] + t[k];
    }
    for (int i = N - 1; i >= 0; i--) {
        const Joint& b = JOINT[i];
        torque[i] = b.axis[0] * moment[i][0] + b.axis[1] * moment[i][1] + b.axis[2] * moment[i][2];
        if (!i) break;
        REAL f[3], m[3], t[3];
        for (int k = 0; k < 3; k++) {
            f[k] = m[k] = 0;
            for (int j = 0; j < 3; j++) f[k] += r[i][3 * k + j] * force[i][j], m[k] += r[i][3 * k + j] * moment[i][j];
        }
        cross(b.place, f, t);
        for (int k = 0; k < 3; k++) force[i - 1][k] += f[k], moment[i - 1][k] += m[k] + t[k];
    }
}

// A step: the mass matrix by columns, its Cholesky factor, velocity, then position.
__device__ static void step(REAL* q, REAL* dq, const REAL* torque, REAL dt, REAL gravity) {
    REAL r[N][9], zero[N], unit[N], x[N], mass[N][N];
    rotations(q, r);
    for (int i = 0; i < N; i++) zero[i] = unit[i] = 0;
    for (int i = 0; i < N; i++) {
        unit[i] = 1;
        rnea(r, zero, unit, 0, mass[i]);
        unit[i] = 0;
    }
    rnea(r, dq, zero, gravity, x);
    for (int i = 0; i < N; i++) {
        x[i] = torque[i] - x[i];
        for (int j = 0; j <= i; j++) {
            REAL s = mass[i][j];
            for (int k = 0; k < j; k++) s -= mass[i][k] * mass[j][k];
            mass[i][j] = i == j ? sqrt(s) : s / mass[j][j];
        }
        for (int k = 0; k < i; k++) x[i] -= mass[i][k] * x[k];
        x[i] /= mass[i][i];
    }
    for (int i = N - 1; i >= 0; i--) {
        for (int k = i + 1; k < N; k++) x[i] -= mass[k][i] * x[k];
        x[i] /= mass[i][i];
    }
    for (int i = 0; i < N; i++) dq[i] += dt * x[i], q[i] += dt * dq[i];
}

// An action of one arm: `steps` steps under a torque, or a PD loop at a goal (q, dq, ddq) with inverse dynamics.
__device__ static void action(REAL* q, REAL* dq, REAL* bend, const REAL* torque, const REAL* goal, const REAL* scale,
                              const REAL* inertia, int steps, int friction, int residual, REAL dt) {
    for (int n = 0; n < steps; n++) {
        REAL u[N], r[N][9];
        for (int i = 0; i < N; i++) u[i] = torque[i];
        if (residual) {
            rotations(goal, r);
            rnea(r, goal + N, goal + 2 * N, (REAL)9.81, u);
            for (int i = 0; i < N; i++) u[i] += inertia[i] * (400 * (goal[i] - q[i]) + 28 * (goal[N + i] - dq[i]));
        }
        if (friction)
            for (int i = 0; i < N; i++) {
                REAL side = (dq[i] > 0) - (dq[i] < 0), v = dq[i] * 10;
                bend[i] = side + (bend[i] - side) * exp(-fabs(dq[i]) * dt * 100);
                u[i] -= scale[i] * ((1 + (REAL)0.3 * exp(-v * v)) * bend[i] + dq[i]);
            }
        step(q, dq, u, dt, (REAL)9.81);
    }
}

#ifdef HOST
extern "C" void actions(int arms, REAL* q, REAL* dq, REAL* bend, const REAL* torque, const REAL* goal,
                        const REAL* scale, const REAL* inertia, int steps, int friction, int residual, REAL dt) {
    for (int k = 0; k < arms; k++)
        action(q + N * k, dq + N * k, bend + N * k, torque, goal, scale, inertia, steps, friction, residual, dt);
}
#else
extern "C" __global__ void actions(int arms, REAL* q, REAL* dq, REAL* bend, const REAL* torque, const REAL* goal,
                                   const REAL* scale, const REAL* inertia, int steps, int friction, int residual,
                                   REAL dt) {
    int k = blockIdx.x * blockDim.x + threadIdx.x;
    if (k >= arms) return;
    REAL a[N], b[N], c[N];
    for (int i = 0; i < N; i++) a[i] = q[N * k + i], b[i] = dq[N * k + i], c[i] = bend[N * k + i];
    action(a, b, c, torque, goal, scale, inertia, steps, friction, residual, dt);
    for (int i = 0; i < N; i++) q[N * k + i] = a[i], dq[N * k + i] = b[i], bend[N * k + i] = c[i];
}
#endif
