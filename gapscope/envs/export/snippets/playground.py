"""MuJoCo Playground: a randomisation function over the model that ``gapscope export --format mjcf`` writes."""

from __future__ import annotations

from gapscope.envs.export.snippets.target import JOINTS, Target

TEMPLATE = """
import jax
import jax.numpy as jp

{% set fields = {"dof_frictionloss": "friction", "dof_damping": "damping", "dof_armature": "rotor"} %}
RANGES = {  # by field of mjx.Model, then by joint
{% for field, name in fields.items() if arm.ranged(name) %}
    "{{ field }}": {{ arm.ranged(name) | table(4) }},
{% endfor %}
}
ADDED_MASS = {{ arm.added_mass | table }}  # kg, by body
ADDED_COM = {  # m along x, y, z of the body
{% for body in arm.bodies %}
    {{ body.name | quoted }}: ({{ body.com[0] | pair }}, {{ body.com[1] | pair }}, {{ body.com[2] | pair }}),
{% endfor %}
}


def domain_randomizer(mj_model):
    \"\"\"A randomization_fn(model, rng) for the joints and bodies of a mujoco.MjModel, by their names.\"\"\"
    dofs = {joint: mj_model.joint(joint).dofadr[0] for ends in RANGES.values() for joint in ends}
    bodies = {body: mj_model.body(body).id for body in (*ADDED_MASS, *ADDED_COM)}

    def domain_randomize(model, rng):
        @jax.vmap
        def drawn(rng):
            fields = {name: getattr(model, name) for name in (*RANGES, "body_mass", "body_ipos")}
            for name, ends in RANGES.items():
                for joint, (low, high) in ends.items():
                    rng, key = jax.random.split(rng)
                    value = jax.random.uniform(key, minval=low, maxval=high)
                    fields[name] = fields[name].at[dofs[joint]].set(value)
            for body, (low, high) in ADDED_MASS.items():
                rng, key = jax.random.split(rng)
                mass = jax.random.uniform(key, minval=low, maxval=high)
                fields["body_mass"] = fields["body_mass"].at[bodies[body]].add(mass)
            for body, ends in ADDED_COM.items():
                rng, key = jax.random.split(rng)
                low, high = jp.array(ends).T
                shift = jax.random.uniform(key, (3,), minval=low, maxval=high)
                fields["body_ipos"] = fields["body_ipos"].at[bodies[body]].add(shift)
            return fields

        fields = drawn(rng)
        in_axes = jax.tree_util.tree_map(lambda x: None, model)
        in_axes = in_axes.tree_replace({name: 0 for name in fields})
        return model.tree_replace(fields), in_axes

    return domain_randomize
"""


LUGRE = (
    "in the file of gapscope export --format mjcf, where dry friction of the joint is lugre of an actuator: leave "
    "dof_frictionloss of the joint out"
)
"""What to know of joints whose dry friction is not constant."""
TWO_MASSES = (
    "in the file of gapscope export --format mjcf, which has a joint of the motor for it, with rotor and friction: "
    "name that joint in RANGES"
)
"""What to know of joints with elasticity or backlash."""


PLAYGROUND = Target(
    name="playground",
    title="MuJoCo Playground 0.2",
    template=TEMPLATE,
    held=JOINTS - {"limit"},
    hints={
        "breakaway": LUGRE,
        "saturating": LUGRE,
        "gear_stiffness": TWO_MASSES,
        "play": TWO_MASSES,
    },
    notes=(
        "Only what has a range is drawn; the values found are in the file of gapscope export --format mjcf.",
        "body_ipos is along the body's axes; the inertia tensor stays as it is.",
    ),
    model="mjcf",
    needs_ranges=True,
)
"""The target."""
