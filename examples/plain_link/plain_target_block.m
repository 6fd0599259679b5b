function [output_v, head, reals, samples_out] = plain_target_block(message_length, head_in, reals_in, samples_v)
% Body of the MATLAB Function block of build_model.m, called in every tick: four ticks per sample interval.
% The numbers below are those of the rig file; change them there and here.
INTERVAL_S = 0.001;
TICKS = 4;
own = struct('range_v', 10, 'fastest_v_s', 130, 'rest_v_s', 10, 'watchdog_s', 0.1, ...
             'coasts', round(0.05 / INTERVAL_S));
persistent t tick
if isempty(t)
    t = plain_target_start();
    tick = 0;
end
is_instant = mod(tick, TICKS) == 0;
now_s = tick * INTERVAL_S / TICKS;
arrived = message_length == 40;
[t, head, reals] = plain_target_step(t, arrived, head_in, reals_in, is_instant, now_s, INTERVAL_S / TICKS, own);
output_v = t.output_v;
samples_out = samples_v;
tick = tick + 1;
end
